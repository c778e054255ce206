"""Figures of single missions, from their run directories: the paper's Fig. 2 to 4 and the pipeline's states."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from nbv.cache import Store
from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface
from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import read_ply
from nbv.rocks import load_rock
from nbv.types import Floats, Ints
from tuner.evaluation.baselines import label as strategy_label
from tuner.report.labels import format_number
from tuner.report.sectors import sector_figure
from tuner.report.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, look, new_figure

MAX_CLOUD_POINTS = 60_000  # more than a pixel each at the printed size
# Ends of the colour bars, fixed so that missions compare: 1 % and 5 % of the rock's height.
CLOUD_ERROR_RANGE_MM = 16.0
MISSING_RANGE_MM = 80.0
_ROCK_GREY = "#8d8d8d"
SECTOR_KEY = "sector_completeness_48mm"
_VIEWS = (
    (-60.0, 18.0),
    (120.0, 18.0),
)  # azimuth (from east, counter-clockwise) and elevation of the two cameras


def mission_config(run: Path) -> MissionConfig:
    """The configuration of a mission's directory; ``UserError`` if it is not there."""
    file = run / "config.yaml"
    if not file.is_file():
        raise UserError(f"{run} holds no config.yaml; name a directory that `gatetune mission run` wrote")
    return config_from_dict(yaml.safe_load(file.read_text()))


def _read_json(run: Path, name: str) -> dict[str, Any]:
    file = run / name
    if not file.is_file():
        raise UserError(
            f"{run} holds no {name}; fly the mission with everything kept (`gatetune mission run`, or --keep all)"
        )
    tree: dict[str, Any] = json.loads(file.read_text())
    return tree


def _trace(run: Path) -> list[dict[str, Any]]:
    file = run / "trace.jsonl"
    if not file.is_file():
        raise UserError(f"{run} holds no trace.jsonl; fly the mission with everything kept")
    return [json.loads(line) for line in file.read_text().splitlines() if line.strip()]


# -- (a) trajectory: the paper's Fig. 2 ----------------------------------------------------------------------


def trajectory_figure(run: Path) -> Figure:
    """Flown path, seed and selected views, and the first iteration's candidates, in ENU (m).

    Left in perspective, right the plan with the selected views numbered in the order of their capture.

    Parameters
    ----------
    run
        A mission's directory with ``flight.json``, ``states/`` and, where it exists, ``cleaned.ply``.

    Raises
    ------
    UserError
        A file is missing.
    """
    config = mission_config(run)
    flight = _read_json(run, "flight.json")
    states = sorted((run / "states").glob("iter_*.npz"))
    if not states:
        raise UserError(f"{run} holds no planning states; fly the mission with everything kept")
    first, pool = load_state(states[0])
    chosen, seeds = _chosen_positions(run), first.visited_m[: first.n_seeds]
    x, y, _ = config.target_m
    reach = 1.08 * max(config.seed.radius_m, config.pool.radius_m)
    orbit, adaptive = _paths(flight, {record["chosen"] for record in _trace(run)}, (x, y), reach)
    # Selected candidates have markers of their own; in perspective the small one would lie on the large.
    taken = (pool.positions_m[:, None] == chosen[None]).all(axis=2).any(axis=1)
    spare = pool.positions_m[~taken]
    cloud = run / "cleaned.ply"
    rock = _thin(read_ply(cloud).points_m, 5000) if cloud.is_file() else np.zeros((0, 3))
    with look():
        figure = new_figure(11.6, 5.6)
        figure.get_layout_engine().set(wspace=0.07)  # type: ignore[union-attr,call-arg]  # two axis labels meet
        space: Any = figure.add_subplot(1, 2, 1, projection="3d")
        plan: Any = figure.add_subplot(1, 2, 2)
        for ax, axes in ((space, 3), (plan, 2)):
            depth = {"depthshade": False} if axes == 3 else {"zorder": 3}
            ax.scatter(*rock.T[:axes], s=0.6, c=_ROCK_GREY, alpha=0.6, linewidths=0, rasterized=True)
            ax.scatter(
                *spare.T[:axes],
                s=10,
                c=SKY,
                linewidths=0,
                alpha=0.8 if axes == 2 else 0.6,
                **depth,
            )
            ax.plot(*orbit.T[:axes], color=GREY, lw=0.9, ls=(0, (4, 2)))
            ax.plot(*adaptive.T[:axes], color=VERMILION, lw=0.9, alpha=0.75)
            ax.scatter(
                *seeds.T[:axes],
                s=30 if axes == 3 else 46,
                c=BLUE,
                marker="o",
                edgecolors="white",
                linewidths=0.5,
                **depth,
            )
            if len(chosen):
                ax.scatter(
                    *chosen.T[:axes],
                    s=46 if axes == 3 else 105,
                    c=ORANGE,
                    marker="^" if axes == 3 else "o",
                    edgecolors="black",
                    linewidths=0.6,
                    **(depth | ({"zorder": 4} if axes == 2 else {})),
                )
        for k, position in enumerate(chosen, 1):
            plan.text(*position[:2], str(k), fontsize=6.5, ha="center", va="center_baseline", zorder=5)
        top = max(float(np.nanmax(orbit[:, 2])), float(pool.positions_m[:, 2].max())) + 0.3
        for ax in (space, plan):
            ax.set_xlim(x - reach, x + reach)
            ax.set_ylim(y - reach, y + reach)
            ax.set_xlabel("east (m)")
            ax.set_ylabel("north (m)")
        plan.set_aspect("equal")
        plan.set_title("from above; numbers: order of capture")
        space.set_zlim(0, top)
        space.set_zlabel("up (m)")
        space.zaxis.set_major_locator(MaxNLocator(4))
        space.set_box_aspect(
            [np.ptp(limits) for limits in (space.get_xlim(), space.get_ylim(), space.get_zlim())], zoom=1.15
        )
        space.view_init(elev=27, azim=-58)
        figure.legend(
            *zip(*_trajectory_legend(len(seeds), len(chosen), len(pool), len(rock) > 0)),
            loc="outside lower center",
            ncols=3,
        )
        return figure


def _trajectory_legend(seeds: int, chosen: int, pool: int, rock: bool) -> list[tuple[Line2D, str]]:
    names = [
        (Line2D([], [], color=BLUE, marker="o", ls="none", mec="white"), f"{seeds} seed views"),
        (
            Line2D([], [], color=ORANGE, marker="^", ls="none", ms=8, mec="black", mew=0.6),
            f"{chosen} selected views (numbered discs from above)",
        ),
        (Line2D([], [], color=SKY, marker="o", ls="none", ms=4), f"{pool} candidates at the first iteration"),
        (Line2D([], [], color=GREY, lw=1, ls=(0, (4, 2))), "flown in the seed phase (markers: as commanded)"),
        (Line2D([], [], color=VERMILION, lw=1), "flown in the adaptive phase"),
    ]
    if rock:
        names.append((Line2D([], [], color=_ROCK_GREY, marker=".", ls="none", ms=4), "dense cloud, cleaned"))
    return names


def _paths(
    flight: dict[str, Any], chosen: set[str], center: tuple[float, float], reach_m: float
) -> tuple[Floats, Floats]:
    """(K, 3) flown in the seed phase and (L, 3) after it, way home left out; NaN outside the drawn square.

    The way from and to home would shrink everything else.
    """
    samples = np.array([sample[:4] for sample in flight["samples"]])
    begins = {event["name"]: event["start_s"] for event in reversed(flight["events"])}
    adaptive_s = min((begins[name] for name in chosen if name in begins), default=np.inf)
    home_s = begins.get("return", np.inf)
    near: np.ndarray = np.all(np.abs(samples[:, 1:3] - center) <= reach_m, axis=1)
    path = np.where(near[:, None], samples[:, 1:], np.nan)
    time = samples[:, 0]
    return path[time <= adaptive_s], path[(time >= adaptive_s) & (time <= home_s)]


def _chosen_positions(run: Path) -> Floats:
    """(K, 3) commanded positions of the selected views, in order."""
    trace, positions = _trace(run), []
    for record in trace:
        _, pool = load_state(run / "states" / f"iter_{record['iteration']:02d}.npz")
        positions.append(pool.positions_m[pool.ids.index(record["chosen"])])
    return np.array(positions).reshape(-1, 3)


# -- (b) completeness per sector: Fig. 3 ---------------------------------------------------------------------


def sectors_figure(runs: Mapping[str, Path], surface: str = "whole") -> Figure:
    """Per-sector completeness at 48 mm of several missions, by label (the paper's Fig. 3).

    Raises
    ------
    UserError
        A mission without metrics, or with other sectors than the first.
    """
    completeness: dict[str, list[list[float | None]]] = {}
    centers: list[float] = []
    for label, run in runs.items():
        result = _read_json(run, "mission.json")
        if result["status"] == "failed":
            raise UserError(f"{run} holds a failed mission ({result['reason']}); leave it out")
        metrics = result["metrics"]
        here = list(metrics["sector_centers_deg"])
        if centers and here != centers:
            raise UserError(f"{run} was measured with other azimuth sectors; compare like with like")
        centers = here
        completeness[label] = [metrics[surface][SECTOR_KEY]]
    if not completeness:
        raise UserError("no mission to show; name at least one run directory")
    return sector_figure(completeness, centers)


# -- (c) ground truth and dense cloud: Fig. 4 ----------------------------------------------------------------


def overlay_figure(run: Path, rock: str) -> Figure:
    """Ground truth and cleaned dense cloud from two opposite sides, coloured by error.

    Upper row: the cloud, each point coloured by its distance to the true surface. Lower row: samples of the true
    surface, coloured by their distance to the cloud: what is missing shows dark. Parallel projection.

    Parameters
    ----------
    run
        A mission's directory with ``cleaned.ply``.
    rock
        Catalogue name or mesh file, as the mission was flown with.

    Raises
    ------
    UserError
        A file is missing or the rock is unknown.
    """
    config = mission_config(run)
    cloud = read_ply(run / "cleaned.ply").points_m
    if len(cloud) == 0:
        raise UserError(f"{run / 'cleaned.ply'} holds no points")
    subject = load_rock(rock, Store())
    wrong_m, cloud_normals = _distance_to_mesh(cloud, subject.vertices_m, subject.faces)
    # The same samples as the metrics: same count, same seed.
    samples, normals = sample_surface(subject.vertices_m, subject.faces, config.evaluation.gt_samples, 0)
    wrong_mm, missing_mm = 1000 * wrong_m, 1000 * nearest_neighbours(cloud, samples)[0]
    shades = LinearSegmentedColormap.from_list("error", ["#cfe8f7", SKY, BLUE, ORANGE, VERMILION, "#3a0f00"])
    reach = float(np.abs(samples[:, :2]).max()) * 1.05
    top = float(samples[:, 2].max()) * 1.05
    with look():
        figure = new_figure(9.4, 7.4)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        # A point is drawn on the side that its surface faces, so that the back does not shine through.
        sets = (
            (
                cloud,
                wrong_mm,
                cloud_normals,
                "dense cloud",
                "distance to true surface (mm)",
                CLOUD_ERROR_RANGE_MM,
            ),
            (samples, missing_mm, normals, "truth", "distance to dense cloud (mm)", MISSING_RANGE_MM),
        )
        for row, (points, error_mm, facing, name, unit, span_mm) in enumerate(sets):
            mappable: Any = None
            for column, (azimuth_deg, elevation_deg) in enumerate(_VIEWS):
                ax = axes[row, column]
                right, up, towards = _camera_axes(azimuth_deg, elevation_deg)
                keep = np.flatnonzero(facing @ towards > 0)
                keep = keep[_thin_indices(len(keep), MAX_CLOUD_POINTS)]
                order = keep[np.argsort(points[keep] @ towards, kind="stable")]  # far points first
                centred = points[order] - np.array(config.target_m)
                mappable = ax.scatter(
                    centred @ right,
                    centred @ up,
                    c=error_mm[order],
                    cmap=shades,
                    vmin=0,
                    vmax=span_mm,
                    s=1.8 if row == 0 else 5.0,
                    linewidths=0,
                    rasterized=True,
                )
                ax.set_aspect("equal")
                ax.grid(False)
                ax.set_xlim(-reach * 1.1, reach * 1.1)
                ax.set_ylim(-top * 0.62, top * 0.62)
                if row == 0:
                    ax.set_title(
                        f"from {_compass(azimuth_deg)} ({azimuth_deg % 360:.0f}°), {elevation_deg:.0f}° up"
                    )
                else:
                    ax.set_xlabel("right of target (m)")
                if column == 0:
                    ax.set_ylabel(f"{name}\nabove target (m)")
            bar = figure.colorbar(
                mappable, ax=list(axes[row]), location="right", shrink=0.85, aspect=18, extend="max"
            )
            bar.set_label(unit)
            bar.set_ticks(np.linspace(0, span_mm, 5).tolist())
        figure.suptitle(
            f"{run.name}: {len(cloud):,} points; {100 * np.mean(missing_mm < 48):.0f} % of the whole true surface within "
            f"48 mm of the cloud, median error of the cloud {format_number(float(np.median(wrong_mm)), 1)} mm",
            fontsize=10,
        )
        return figure


def _distance_to_mesh(points: Floats, vertices_m: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """(N,) distances to the surface itself and (N, 3) normals at the nearest places.

    Not to samples of it, as the metrics have them: at 50,000 samples their spacing alone is several millimetres,
    more than the error of a good cloud.
    """
    places, normals = RayCaster(vertices_m, faces).nearest(points)
    return np.linalg.norm(points - places, axis=1), normals


def _camera_axes(azimuth_deg: float, elevation_deg: float) -> tuple[Floats, Floats, Floats]:
    """Right, up and towards-the-camera unit vectors of an orthographic view from that side."""
    a, e = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return right, np.cross(towards, right), towards


def _compass(azimuth_deg: float) -> str:
    names = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
    return names[round(azimuth_deg / 45) % 8]


def _thin(points: Floats, count: int) -> Floats:
    return points[_thin_indices(len(points), count)]


def _thin_indices(total: int, count: int) -> np.ndarray:
    """At most ``count`` indices of ``range(total)``: a fixed random choice, in order."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(0).permutation(total)[:count])


# -- (d) pipeline states -------------------------------------------------------------------------------------


def pipeline_figure(run: Path) -> Figure:
    """Per adaptive iteration: scorer flown, d95 with the gate's threshold, sparse points, registered images.

    Raises
    ------
    UserError
        There is no trace, or it is empty.
    """
    config, trace = mission_config(run), _trace(run)
    if not trace:
        raise UserError(f"{run} flew no adaptive capture; there is nothing to show")
    k = np.array([record["iteration"] + 1 for record in trace])
    colours = {"b-aware": VERMILION, "covis": BLUE}
    scorers = [str(record["scorer"]) for record in trace]
    kinds = list(dict.fromkeys(scorers))
    spare = iter((GREEN, PURPLE, ORANGE, SKY, GREY))
    shade = {kind: colours.get(kind) or next(spare) for kind in kinds}
    with look():
        figure = new_figure(8.2, 6.4)
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(0.55, 1.2, 1, 1))
        axes[0].bar(k, np.ones(len(k)), width=0.92, color=[shade[name] for name in scorers])
        for x, record in zip(k, trace):
            top, text = record.get("top", {}), ""
            picks = {name: best.get("candidate") for name, best in top.items()}
            if len(set(picks.values())) == 1 and len(picks) > 1:
                text = "="
            axes[0].text(x, 0.5, text, ha="center", va="center", color="white", fontsize=10)
        axes[0].set_yticks([])
        axes[0].grid(False)
        axes[0].set_ylabel("scorer", rotation=0, ha="right", va="center")
        axes[1].plot(k, [1000 * record["d95_m"] for record in trace], "-o", color=BLUE, ms=4)
        if config.gate.kind == "hyb-h":
            axes[1].axhline(1000 * config.gate.d95_m, color=VERMILION, ls="--", lw=1.2)
            axes[1].annotate(
                f"gate threshold {1000 * config.gate.d95_m:.0f} mm",
                (1, 1000 * config.gate.d95_m),
                xycoords=axes[1].get_yaxis_transform(),
                xytext=(0, 3),
                textcoords="offset points",
                ha="right",
                color=VERMILION,
                fontsize=8.5,
            )
            last = int(np.ceil(config.gate.budget_fraction * config.stop.adaptive_budget))
            if 0 < last < k[-1]:
                for ax in axes[:2]:
                    ax.axvline(last + 0.5, color="black", ls=":", lw=1.3)
                axes[1].annotate(
                    f"$f_b$ reaches {config.gate.budget_fraction:g}",
                    (last + 0.5, 1),
                    xycoords=axes[1].get_xaxis_transform(),
                    xytext=(4, -10),
                    textcoords="offset points",
                    fontsize=8.5,
                )
        axes[1].set_ylabel("d95 (mm)")
        axes[2].plot(k, [record["n_points"] for record in trace], "-o", color=GREEN, ms=4)
        axes[2].set_ylabel("sparse points")
        seeds = sum(config.seed.ring_azimuth_counts)
        axes[3].plot(
            k, [seeds + x - 1 for x in k], color="black", ls=":", lw=1.6, zorder=5, label="photographs taken"
        )
        axes[3].plot(
            k, [record["n_registered"] for record in trace], "-o", color=PURPLE, ms=4, label="registered"
        )
        lost = [x for x, record in zip(k, trace) if not record["registered"]]
        if lost:
            axes[3].plot(
                lost,
                np.full(len(lost), 0.06),
                "x",
                color=VERMILION,
                ms=7,
                mew=1.8,
                transform=axes[3].get_xaxis_transform(),
                label="new image did not register",
            )
        axes[3].set_ylabel("images")
        axes[3].legend(loc="upper left", ncols=3)
        axes[3].set_xlabel("adaptive iteration; every value is the state before its capture")
        for ax in axes[1:]:
            ax.margins(y=0.18)
            ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))
        axes[3].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes[0].set_xlim(0.4, k[-1] + 0.6)
        handles = [Line2D([], [], color=shade[kind], lw=7, label=strategy_label(kind)) for kind in kinds]
        if len(trace[0].get("top", {})) > 1:
            handles.append(
                Line2D(
                    [],
                    [],
                    ls="none",
                    marker="$=$",
                    ms=9,
                    mew=0,
                    color=GREY,
                    label="all scorers prefer the same view",
                )
            )
        figure.legend(handles=handles, loc="outside upper center", ncols=4)
        figure.align_ylabels(axes[1:])
        return figure


# -- all of them ---------------------------------------------------------------------------------------------


def write_mission_figures(runs: Mapping[str, Path], out: Path, rock: str) -> list[Path]:
    """All figures of several missions on one rock as PNG files.

    Parameters
    ----------
    runs
        Run directories by label, e.g. ``{"Covis": ..., "Hyb-O": ...}``; flown with everything kept.
    out
        Directory of the figures.
    rock
        Catalogue name or mesh file the missions were flown on.

    Returns
    -------
    ``trajectory_LABEL.png``, ``overlay_LABEL.png`` and ``pipeline_LABEL.png`` per mission, and ``sectors.png``.
    """
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []

    def save(figure: Figure, name: str) -> None:
        path = out / f"{name}.png"
        with look():
            figure.savefig(path, dpi=160, metadata={"Software": None})
        written.append(path)

    for label, run in runs.items():
        safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in label)
        save(trajectory_figure(run), f"trajectory_{safe}")
        save(overlay_figure(run, rock), f"overlay_{safe}")
        save(pipeline_figure(run), f"pipeline_{safe}")
    save(sectors_figure(runs), "sectors")
    return written


def labels_of(runs: Sequence[Path]) -> dict[str, Path]:
    """Label each mission with its strategy; missions of one strategy get their directory's name added."""
    kinds = [strategy_label(mission_config(run).gate.kind) for run in runs]
    return {kind if kinds.count(kind) == 1 else f"{kind} ({run.name})": run for kind, run in zip(kinds, runs)}
