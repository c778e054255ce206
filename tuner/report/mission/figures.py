"""Figures of single missions, from their run directories, and the paper's Fig. 3 of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from tuner.evaluation.baselines import label as strategy_label
from tuner.report.mission.overlay import overlay_figure
from tuner.report.mission.run_files import mission_config
from tuner.report.mission.sectors import sectors_figure
from tuner.report.mission.trajectory import trajectory_figure
from tuner.report.style import save_figure


def write_mission_figures(runs: Mapping[str, Path], out: Path, rock: str | None = None) -> list[Path]:
    """Write ``trajectory_LABEL.png`` and ``overlay_LABEL.png`` of each mission and ``sectors.png`` of all into ``out``.

    ``runs``: directories of missions on one rock by label, such as ``{"Covis": ..., "Hyb-O": ...}``, flown with everything
    kept; ``rock``: catalogue name or mesh file, for one that is not in the catalogue under the missions' name for it.
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
