"""Figures of missions from their run directories: the paper's Fig. 2, 3 and 4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from nbv.cache import Store
from nbv.errors import UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import read_ply
from nbv.terrain import buried_rock
from nbv.types import Floats
from tuner.evaluation.baselines import label as strategy_label
from tuner.missions.registry import is_geometric
from tuner.report.mission_files import decided, mission_config, read_flight, the_rock, thin_indices
from tuner.report.style import (
    BLUE,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    colour,
    look,
    marker,
    new_figure,
    save_figure,
)

MAX_CLOUD_POINTS = 60_000  # more than a pixel each at the printed size
# Ends of the colour bars, fixed so that missions compare: 1 % and 5 % of the rock's height.
CLOUD_ERROR_RANGE_MM, MISSING_RANGE_MM = 16.0, 80.0
# Azimuths of the two cameras, counter-clockwise from east.
_SIDES = {"south-east": -60.0, "north-west": 120.0}
_ELEVATION_DEG = 18.0


def write_mission_figures(runs: Mapping[str, Path], out: Path, rock: str | None = None) -> list[Path]:
    """Write ``trajectory_LABEL.png`` and ``overlay_LABEL.png`` of each mission and ``sectors.png`` of all into ``out``.

    A geometric mission has no cloud with errors and so no overlay.

    ``runs``: directories of missions on one rock by label, such as ``{"Covis": ..., "Hyb-O": ...}``, run with everything
    kept; ``rock``: catalogue name or mesh file, for one that is not in the catalogue under the missions' name for it.
    """
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for label, run in runs.items():
        safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in label)
        written.append(save_figure(trajectory_figure(run), out, f"trajectory_{safe}"))
        geometric = is_geometric(MissionResult.load(run).provenance.get("fidelity", ""))
        if not geometric or (run / "cleaned.ply").is_file():
            written.append(save_figure(overlay_figure(run, rock), out, f"overlay_{safe}"))
    return [*written, save_figure(sectors_figure(runs), out, "sectors")]


def labels_of(runs: Sequence[Path]) -> dict[str, Path]:
    """Label each mission with its strategy; missions of one strategy get their directory's name added."""
    kinds = [strategy_label(mission_config(run).gate.kind) for run in runs]
    return {kind if kinds.count(kind) == 1 else f"{kind} ({run.name})": run for kind, run in zip(kinds, runs)}


# -- Fig. 2: the run path with its views ---------------------------------------------------------------------


def trajectory_figure(run: Path) -> Figure:
    """Run path, seed and selected views, and the first iteration's candidates from above, in ENU (m).

    The selected views are numbered in the order of their capture. ``run``: a mission's directory with ``flight.json``,
    ``states/`` and, where it exists, ``cleaned.ply``; ``UserError`` where a file is missing.
    """
    config, flight, known = mission_config(run), read_flight(run), decided(run, MissionResult.load(run))
    chosen = _places([pool.positions_m[pool.ids.index(record.chosen)] for _, pool, record in known])
    candidates, taken = np.zeros((0, 3)), np.zeros(0, dtype=bool)
    if known:
        first, pool, _ = known[0]
        seeds, candidates = first.visited_m[: first.n_seeds], pool.positions_m
        # Selected candidates have markers of their own; in perspective the small one would lie on the large.
        taken = (candidates[:, None] == chosen[None]).all(axis=2).any(axis=1)
    else:  # as photographed, since what was commanded is kept with the decisions
        seeds = _places(list(flight.photographed_m().values()))
    cloud = run / "cleaned.ply"
    rock = read_ply(cloud).points_m if cloud.is_file() else np.zeros((0, 3))
    rock = rock[thin_indices(len(rock), 5000)]
    x, y, _ = config.target_m
    reach = 1.08 * max(config.seed.radius_m, config.pool.radius_m)

    # What is run in either phase; NaN outside the drawn square, since the way from and to home would shrink all else.
    time_s, home_s = flight.samples[:, 0], flight.begins_s.get("return", np.inf)
    begins = [flight.begins_s[r.chosen] for *_, r in known if r.chosen in flight.begins_s]
    adaptive_s = min(begins, default=np.inf)
    near: np.ndarray = np.all(np.abs(flight.samples[:, 1:3] - (x, y)) <= reach, axis=1)
    path = np.where(near[:, None], flight.samples[:, 1:], np.nan)
    phases = [(path[time_s <= adaptive_s], GREY, "run in the seed phase")]
    if len(chosen):
        later = path[(time_s >= adaptive_s) & (time_s <= home_s)]
        phases.append((later, VERMILION, "run in the adaptive phase"))

    with look():
        figure = new_figure(6.4, 6.8)
        plan = figure.subplots()

        def mark(points: Floats, size: float, fill: str, label: str, edge: str = "none") -> None:
            if len(points):
                plan.scatter(
                    points[:, 0], points[:, 1], s=size, c=fill, edgecolors=edge, label=label, zorder=3
                )

        mark(rock, 0.6, "#8d8d8d", "dense cloud, cleaned")
        mark(candidates[~taken], 10, SKY, f"{len(candidates)} candidates at the first iteration")
        mark(seeds, 40, BLUE, f"{len(seeds)} seed views", "white")
        mark(chosen, 90, ORANGE, f"{len(chosen)} selected views, in their order", "black")
        for evaluated, shade, label in phases:
            plan.plot(*evaluated.T[:2], color=shade, lw=0.9, label=label)
        for k, (east, north, _) in enumerate(chosen, 1):
            plan.text(east, north, str(k), fontsize=6.5, ha="center", va="center_baseline", zorder=5)
        plan.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach))
        plan.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
        figure.legend(*plan.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure


def _places(found: Sequence[Floats]) -> Floats:
    return np.array(found).reshape(-1, 3)


# -- Fig. 3: completeness by azimuth sector --------------------------------------------------------------------


def sectors_figure(runs: Mapping[str, Path]) -> Figure:
    """Per-sector completeness at 48 mm of several missions, by label.

    Sector centres are azimuths in degrees, counter-clockwise from east, as ``nbv.evaluation`` defines them.

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
        here = list(result.metrics["sector_centers_deg"])
        if centers and here != centers:
            raise UserError(f"{run} was measured with other azimuth sectors; compare like with like")
        centers = here
        completeness[label] = result.metrics["whole"]["sector_completeness_48mm"]
    with look():
        figure = new_figure(6.6, 4.8)
        ax: Any = figure.add_subplot(projection="polar")
        angles = np.deg2rad(np.asarray(centers, dtype=float))
        lowest = 100.0
        for i, (label, sectors) in enumerate(completeness.items()):
            values = np.array([np.nan if v is None else v for v in sectors], dtype=float)
            lowest = min(lowest, float(np.nanmin(values, initial=100.0)))
            around, ring = np.append(angles, angles[0]), np.append(values, values[0])
            ax.plot(around, ring, color=colour(i), marker=marker(i), ms=4.5, label=label)
        bottom = 0.0 if lowest < 40 else 10 * np.floor(lowest / 10) - 10
        ax.set_ylim(bottom, 100)
        ax.yaxis.set_major_locator(MaxNLocator(4))
        ax.yaxis.set_major_formatter("{x:g} %")
        ax.set_xticks(angles, [f"{center:g}°" for center in centers])
        ax.set_xlabel(
            f"completeness at 48 mm; 0° east, 90° north, labels at sector centres; "
            f"the plot’s centre is {bottom:g} %",
            fontsize=8,
        )
        ax.legend(loc="center left", bbox_to_anchor=(1.14, 0.5))
        return figure


# -- Fig. 4: ground truth and dense cloud, coloured by error ---------------------------------------------------


def overlay_figure(run: Path, rock: str | None = None) -> Figure:
    """Ground truth and cleaned dense cloud from two opposite sides, coloured by error.

    Upper row: the cloud, each point coloured by its distance to the true surface (not to samples of it, whose spacing
    is more than the error of a good cloud). Lower row: samples of the true surface, coloured by their distance to the
    cloud: what is missing shows dark. Parallel projection.

    ``run``: a mission's directory with ``cleaned.ply``; ``rock`` as for `the_rock`. ``UserError`` where a file is missing or
    the rock is unknown.
    """
    config, result = mission_config(run), MissionResult.load(run)
    cloud = read_ply(run / "cleaned.ply").points_m
    if len(cloud) == 0:
        raise UserError(f"{run / 'cleaned.ply'} holds no points")
    subject = buried_rock(the_rock(run, result, rock, Store()), config)
    places, cloud_normals = RayCaster(subject.vertices_m, subject.faces).nearest(cloud)
    wrong_mm = 1000 * np.linalg.norm(cloud - places, axis=1)
    # The same samples as the metrics: same count, same seed.
    samples, normals = sample_surface(subject.vertices_m, subject.faces, config.evaluation.gt_samples, 0)
    missing_mm = 1000 * nearest_neighbours(cloud, samples)[0]
    wrong = (cloud, cloud_normals, wrong_mm, CLOUD_ERROR_RANGE_MM)
    missing = (samples, normals, missing_mm, MISSING_RANGE_MM)
    rows = {
        "distance of the cloud to the true surface (mm)": wrong,
        "distance of the truth to the cloud (mm)": missing,
    }
    shades = LinearSegmentedColormap.from_list("error", ["#cfe8f7", SKY, BLUE, ORANGE, VERMILION, "#3a0f00"])
    with look():
        figure = new_figure(9.4, 7.4)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for row, (unit, (points, facing, error_mm, span_mm)) in zip(axes, rows.items()):
            for ax, (side, azimuth_deg) in zip(row, _SIDES.items()):
                right, up, towards = _camera_axes(azimuth_deg)
                # A point is drawn on the side that its surface faces, so that the back does not shine through.
                seen = np.flatnonzero(facing @ towards > 0)
                seen = seen[thin_indices(len(seen), MAX_CLOUD_POINTS)]
                seen = seen[np.argsort(points[seen] @ towards, kind="stable")]  # far points first
                centred = points[seen] - np.array(config.target_m)
                shown = {"cmap": shades, "vmin": 0, "vmax": span_mm, "s": 3, "linewidths": 0}
                dots = ax.scatter(centred @ right, centred @ up, c=error_mm[seen], rasterized=True, **shown)
                ax.set(title=f"from {side}", xlabel="right of target (m)", ylabel="above target (m)")
                ax.set_aspect("equal")
                ax.label_outer()
            figure.colorbar(dots, ax=list(row), label=unit, shrink=0.85, extend="max")
        figure.suptitle(
            f"{run.name}: {len(cloud):,} points; {100 * np.mean(missing_mm < 48):.0f} % of the whole true surface within "
            f"48 mm of the cloud, median error of the cloud {np.median(wrong_mm):.1f} mm",
            fontsize=10,
        )
        return figure


def _camera_axes(azimuth_deg: float) -> tuple[Floats, Floats, Floats]:
    """Right, up and towards-the-camera unit vectors of an orthographic view from that side."""
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(_ELEVATION_DEG)
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return right, np.cross(towards, right), towards
