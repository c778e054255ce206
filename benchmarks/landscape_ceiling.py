"""How high a geometric landscape is: a search on the noiseless truth, with many times an optimiser's budget.

    OMP_NUM_THREADS=1 python benchmarks/landscape_ceiling.py --space gate_and_weights --jobs 2

Every configuration is judged as in ``optimiser_comparison.py``: the mean over the rocks of four replicates that no
campaign flies, so what an optimiser may not see is searched here on purpose. First the paper's values and a Sobol
sequence, then rounds of changes to the best ones found (a few coordinates at a time, small and large steps). Says the
best value, how many configurations are within 0.002 of it, and the best after each round: where the last rounds find
nothing more, an optimiser that ends there cannot be beaten.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parent.parent)]

import numpy as np  # noqa: E402
from optimiser_problems import ROCKS, GeometricProblem, Memo, source_digest  # noqa: E402

from nbv.types import Floats  # noqa: E402
from tuner.problem.search_space import SearchSpace, Values  # noqa: E402
from tuner.samplers.design import sobol_point  # noqa: E402

SEED = 20_000  # no run of the comparison has it
SAME = 0.002  # points of F-score: one plateau
PARENTS = 8
STEPS = (0.02, 0.5)  # standard deviation of a change, of each parameter's range: smallest and largest

_problem: GeometricProblem | None = None


def _start(space: str, rocks: tuple[str, ...], memo: Path) -> None:
    global _problem
    _problem = GeometricProblem(space, SEED, Memo(memo, source_digest()), rocks)


def _truth(values: Values) -> float:
    assert _problem is not None
    return _problem.truth(values)


def changed(space: SearchSpace, parents: Floats, count: int, rng: np.random.Generator) -> list[Values]:
    """``count`` configurations, each a parent (unit positions) with some coordinates moved."""
    d = space.dimension
    chosen = parents[np.arange(count) % len(parents)]
    smallest, largest = STEPS
    sd = np.exp(rng.uniform(np.log(smallest), np.log(largest), (count, 1)))
    moves = rng.random((count, d)) < rng.uniform(1 / d, 1.0, (count, 1))
    moves[np.arange(count), rng.integers(d, size=count)] = True
    moved = np.where(moves, chosen + sd * rng.standard_normal((count, d)), chosen)
    return [space.from_unit(x) for x in space.redraw_choices(np.clip(moved, 0.0, 1.0), chosen, rng)]


def main() -> None:
    """Search and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--space", required=True)
    parser.add_argument("--rocks", nargs="+", default=list(ROCKS))
    parser.add_argument("--sobol", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--per-round", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/landscape_ceiling"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    start: tuple[Any, ...] = (
        arguments.space,
        tuple(arguments.rocks),
        arguments.out / "geometric_missions.sqlite",
    )
    _start(*start)
    assert _problem is not None
    space, rng = _problem.space, np.random.default_rng(SEED)
    flown: list[tuple[float, Values]] = []
    with (
        ProcessPoolExecutor(arguments.jobs, initializer=_start, initargs=start) as pool,
        (arguments.out / f"{arguments.space}.jsonl").open("w") as log,
    ):
        for number in range(arguments.rounds + 1):
            if number == 0:
                batch = [_problem.default, *(sobol_point(space, SEED, i) for i in range(arguments.sobol))]
            else:
                # Ties, a plateau's configurations, in random order: other parents every round.
                order = np.lexsort([rng.random(len(flown)), [-round(truth / SAME) for truth, _ in flown]])
                parents = np.array([space.to_unit(flown[i][1]) for i in order[:PARENTS]])
                batch = changed(space, parents, arguments.per_round, rng)
            for values, truth in zip(batch, pool.map(_truth, batch, chunksize=4)):
                flown.append((truth, values))
                print(json.dumps({"round": number, "truth": truth, "values": values}), file=log, flush=True)
            truths = np.array([truth for truth, _ in flown])
            same = int((truths > truths.max() - SAME).sum())
            print(
                f"round {number:2d}: {len(flown):5d} configurations, best {truths.max():.3f} ({same} of them), "
                f"paper's values {flown[0][0]:.3f}, median {np.median(truths):.3f}",
                flush=True,
            )
    print(json.dumps(max(flown, key=lambda f: f[0])[1], indent=1))


if __name__ == "__main__":
    main()
