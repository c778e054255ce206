"""The flown path with its views: the paper's Fig. 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from nbv.mission.planning_state import load_state
from nbv.mission.result import MissionResult
from nbv.mission.run_directory import read_ply
from nbv.types import Floats
from tuner.report.mission.run_files import arrivals, mission_config, read_flight, thin_indices
from tuner.report.style import BLUE, GREY, ORANGE, SKY, VERMILION, look, new_figure

_ROCK_GREY = "#8d8d8d"


def trajectory_figure(run: Path) -> Figure:
    """Flown path, seed and selected views, and the first iteration's candidates from above, in ENU (m).

    The selected views are numbered in the order of their capture. ``run``: a mission's directory with ``flight.json``,
    ``states/`` and, where it exists, ``cleaned.ply``; ``UserError`` where a file is missing.
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
    orbit, adaptive = _paths(
        flight, {record.chosen for record in MissionResult.load(run).trace}, (x, y), reach
    )
    # Selected candidates have markers of their own; in perspective the small one would lie on the large.
    taken = (candidates[:, None] == chosen[None]).all(axis=2).any(axis=1)
    cloud = run / "cleaned.ply"
    rock = read_ply(cloud).points_m if cloud.is_file() else np.zeros((0, 3))
    marks: list[tuple[Floats, dict[str, Any]]] = [
        (
            rock[thin_indices(len(rock), 5000)],
            {"s": 0.6, "c": _ROCK_GREY, "linewidths": 0, "label": "dense cloud, cleaned"},
        ),
        (
            candidates[~taken],
            {
                "s": 10,
                "c": SKY,
                "linewidths": 0,
                "label": f"{len(candidates)} candidates at the first iteration",
            },
        ),
        (seeds, {"s": 40, "c": BLUE, "edgecolors": "white", "label": f"{len(seeds)} seed views"}),
        (
            chosen,
            {
                "s": 90,
                "c": ORANGE,
                "edgecolors": "black",
                "label": f"{len(chosen)} selected views, in their order",
            },
        ),
    ]
    paths = [(orbit, GREY, "flown in the seed phase"), (adaptive, VERMILION, "flown in the adaptive phase")]
    with look():
        figure = new_figure(6.4, 6.8)
        plan = figure.subplots()
        for points, style in marks:
            if len(points):
                plan.scatter(*points.T[:2], **style, zorder=3)
        for path, shade, label in paths if len(chosen) else paths[:1]:
            plan.plot(*path.T[:2], color=shade, lw=0.9, label=label)
        for k, position in enumerate(chosen, 1):
            plan.text(
                position[0], position[1], str(k), fontsize=6.5, ha="center", va="center_baseline", zorder=5
            )
        plan.set(xlim=(x - reach, x + reach), ylim=(y - reach, y + reach))
        plan.set(xlabel="east (m)", ylabel="north (m)", aspect="equal")
        figure.legend(*plan.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure


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
    positions = []
    for record in MissionResult.load(run).trace:
        _, pool = load_state(run / "states" / f"iter_{record.iteration:02d}.npz")
        positions.append(pool.positions_m[pool.ids.index(record.chosen)])
    return np.array(positions).reshape(-1, 3)
