"""The same seeds, then two planners' views, from above: which photographs registered when taken, and the points of the models.

python -m research.photographs.picture OUT/SET_12+8/b-aware__paper/r0 OUT/SET_12+8/predicted__alone/r0 --out FILE.png
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from nbv.mission import MissionResult
from nbv.mission.planning_state import load_state
from nbv.types import Bools, Floats
from research.photographs.registers import row_of
from tuner.report.style import BLUE, GREY, LIGHT, VERMILION, look, new_figure, save_figure

_DOTS = 6000


@dataclass(frozen=True)
class MissionFacts:
    """What a mission left of itself (`research.photographs.registers fly`)."""

    name: str
    score: float
    points_m: Floats  # (N, 3) of the model before the last photograph
    at_m: Floats  # (V, 3) of all photographs, seeds first
    registered: Bools  # (V,) when taken: seeds in the first model, views in the one after each
    seeds: int


def read(where: Path) -> MissionFacts:
    """What the first and the last planning state of a mission hold, and what became of the views."""
    result = MissionResult.load(where)
    facts = (where / "arm.txt").read_text().splitlines()
    first, last = result.trace[0], result.trace[-1]
    begun, _ = load_state(where / "states" / f"iter_{first.iteration:02d}.npz")
    state, pool = load_state(where / "states" / f"iter_{last.iteration:02d}.npz")
    at_m = np.vstack([state.visited_m, pool.positions_m[pool.ids.index(last.chosen)]])
    seeds = [f"seed_{k:02d}.png" in begun.model.camera_names for k in range(begun.n_seeds)]
    registered = np.array(seeds + [record.registered for record in result.trace])
    score = row_of(facts, result)["f_score"]
    return MissionFacts(facts[3], score, state.model.points_m, at_m, registered, begun.n_seeds)


def draw(axis: Axes, found: MissionFacts) -> None:
    """From above, in metres."""
    step = max(1, len(found.points_m) // _DOTS)
    axis.plot(*found.points_m[::step, :2].T, ".", color=GREY, markersize=1, label="points of the model")
    of_seeds = np.arange(len(found.at_m)) < found.seeds
    for chosen, marker, what in ((of_seeds, "o", "seed"), (~of_seeds, "^", "planned")):
        for well, shade, said in ((True, BLUE, "registered"), (False, VERMILION, "not registered")):
            at_m = found.at_m[chosen & (found.registered == well)]
            axis.plot(
                *at_m[:, :2].T,
                marker,
                color=shade,
                markersize=9 if what == "planned" else 6,
                markerfacecolor=LIGHT if what == "seed" else shade,
                label=f"{what}, {said}",
            )
    seeds, planned = int(found.registered[of_seeds].sum()), int(found.registered[~of_seeds].sum())
    views = len(found.at_m) - found.seeds
    axis.set_title(
        f"{found.name}: F-score {found.score:.1f}\n"
        f"{seeds} of {found.seeds} seeds and {planned} of {views} views registered when taken"
    )
    axis.set_aspect("equal")
    axis.set_xlabel("east (m)")


def main() -> None:
    """Two missions side by side."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("missions", type=Path, nargs=2)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    found = [read(where) for where in asked.missions]
    all_m = np.vstack([one.at_m[:, :2] for one in found])
    low_m, high_m = all_m.min(axis=0) - 0.5, all_m.max(axis=0) + 0.5
    with look():
        figure = new_figure(10.0, 5.4)
        axes = figure.subplots(1, 2, sharey=True)
        for axis, one in zip(axes, found, strict=True):
            draw(axis, one)
            axis.set_xlim(low_m[0], high_m[0])
            axis.set_ylim(low_m[1], high_m[1])
        axes[0].set_ylabel("north (m)")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncol=5)
        save_figure(figure, asked.out.parent, asked.out.stem)


if __name__ == "__main__":
    main()
