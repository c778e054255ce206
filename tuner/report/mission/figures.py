"""Figures of single missions, from their run directories, and the paper's Fig. 3 of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.evaluation.baselines import label as strategy_label
from tuner.report.mission.overlay import overlay_figure
from tuner.report.mission.run_files import mission_config
from tuner.report.mission.sectors import sector_figure
from tuner.report.mission.trajectory import trajectory_figure
from tuner.report.style import save_figure

SECTOR_KEY = "sector_completeness_48mm"


def sectors_figure(runs: Mapping[str, Path], surface: str = "whole") -> Figure:
    """Per-sector completeness at 48 mm of several missions, by label (the paper's Fig. 3).

    Raises
    ------
    UserError
        A mission without metrics, or with other sectors than the first.
    """
    completeness: dict[str, list[float | None]] = {}
    centers: list[float] = []
    for label, run in runs.items():
        result = MissionResult.load(run)
        if result.status == "failed":
            raise UserError(f"{run} holds a failed mission ({result.reason}); leave it out")
        metrics = result.metrics
        here = list(metrics["sector_centers_deg"])
        if centers and here != centers:
            raise UserError(f"{run} was measured with other azimuth sectors; compare like with like")
        centers = here
        completeness[label] = metrics[surface][SECTOR_KEY]
    if not completeness:
        raise UserError("no mission to show; name at least one run directory")
    return sector_figure(completeness, centers)


def write_mission_figures(runs: Mapping[str, Path], out: Path, rock: str | None = None) -> list[Path]:
    """All figures of several missions on one rock as PNG files.

    Parameters
    ----------
    runs
        Run directories by label, e.g. ``{"Covis": ..., "Hyb-O": ...}``; flown with everything kept.
    out
        Directory of the figures.
    rock
        Catalogue name or mesh file, for a rock that is not in the catalogue under the missions' name for it.

    Returns
    -------
    ``trajectory_LABEL.png`` and ``overlay_LABEL.png`` per mission, and ``sectors.png``.
    """
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []

    def save(figure: Figure, name: str) -> None:
        written.append(save_figure(figure, out, name))

    for label, run in runs.items():
        safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in label)
        save(trajectory_figure(run), f"trajectory_{safe}")
        save(overlay_figure(run, rock), f"overlay_{safe}")
    save(sectors_figure(runs), "sectors")
    return written


def labels_of(runs: Sequence[Path]) -> dict[str, Path]:
    """Label each mission with its strategy; missions of one strategy get their directory's name added."""
    kinds = [strategy_label(mission_config(run).gate.kind) for run in runs]
    return {kind if kinds.count(kind) == 1 else f"{kind} ({run.name})": run for kind, run in zip(kinds, runs)}
