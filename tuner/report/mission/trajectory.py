"""The flown path with its views: the paper's Fig. 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from nbv.mission.planning_state import load_state
from nbv.mission.run_directory import read_ply
from nbv.types import Floats
from tuner.report.mission.run_files import arrivals, mission_config, read_flight, read_trace
from tuner.report.mission.thinning import thin_indices
from tuner.report.style import BLUE, GREY, ORANGE, SKY, VERMILION, look, new_figure

_ROCK_GREY = "#8d8d8d"


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
    flight = read_flight(run)
    states = sorted((run / "states").glob("iter_*.npz"))
    if states:
        first, pool = load_state(states[0])
        seeds, candidates = first.visited_m[: first.n_seeds], pool.positions_m
    else:  # as photographed, since what was commanded is kept with the decisions
        places = [place for name, place in arrivals(flight).items() if name.startswith("seed_")]
        seeds, candidates = np.array(places).reshape(-1, 3), np.zeros((0, 3))
    chosen = _chosen_positions(run)
    x, y, _ = config.target_m
    reach = 1.08 * max(config.seed.radius_m, config.pool.radius_m)
    orbit, adaptive = _paths(flight, {record["chosen"] for record in read_trace(run)}, (x, y), reach)
    # Selected candidates have markers of their own; in perspective the small one would lie on the large.
    taken = (candidates[:, None] == chosen[None]).all(axis=2).any(axis=1)
    spare = candidates[~taken]
    cloud = run / "cleaned.ply"
    rock = read_ply(cloud).points_m if cloud.is_file() else np.zeros((0, 3))
    rock = rock[thin_indices(len(rock), 5000)]
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
        top = max(float(np.nanmax(orbit[:, 2])), float(candidates[:, 2].max(initial=0.0))) + 0.3
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
            *zip(*_trajectory_legend(len(seeds), len(chosen), len(candidates), len(rock) > 0, bool(states))),
            loc="outside lower center",
            ncols=3,
        )
        return figure


def _trajectory_legend(
    seeds: int, chosen: int, pool: int, rock: bool, commanded: bool
) -> list[tuple[Line2D, str]]:
    names = [
        (Line2D([], [], color=BLUE, marker="o", ls="none", mec="white"), f"{seeds} seed views"),
        (
            Line2D([], [], color=GREY, lw=1, ls=(0, (4, 2))),
            f"flown in the seed phase (markers: as {'commanded' if commanded else 'flown'})",
        ),
    ]
    if chosen:
        disc = Line2D([], [], color=ORANGE, marker="^", ls="none", ms=8, mec="black", mew=0.6)
        names.insert(1, (disc, f"{chosen} selected views (numbered discs from above)"))
        names.append((Line2D([], [], color=VERMILION, lw=1), "flown in the adaptive phase"))
    if pool:
        dot = Line2D([], [], color=SKY, marker="o", ls="none", ms=4)
        names.append((dot, f"{pool} candidates at the first iteration"))
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
    trace, positions = read_trace(run), []
    for record in trace:
        _, pool = load_state(run / "states" / f"iter_{record['iteration']:02d}.npz")
        positions.append(pool.positions_m[pool.ids.index(record["chosen"])])
    return np.array(positions).reshape(-1, 3)
