"""Optimisers against each other at equal cost: N seeds x strategies x problems.

    OMP_NUM_THREADS=1 python -m research.optimiser_comparison run --problem hartmann6:0.1 --strategy gp tpe
    python -m research.optimiser_comparison summary

``run`` writes one JSON-lines file per (problem, strategy, seed) under ``--out`` and skips those that are
complete. ``summary`` (``optimiser_summary.py``) turns them into tables. The lines of a file:

``{"kind": "run", "problem", "strategy", "seed", "budget", "dimension", "rocks", "best", "default_truth"}``
``{"kind": "mission", "cost", "values", "rock", "replicate", "value", "ask_s"}``
    ``cost`` is what has been spent so far, in missions; ``ask_s`` CPU seconds.
``{"kind": "checkpoint", "cost", "values", "truth", "mean", "sd", "loo"}``
    the recommendation at that cost, its noiseless value, our GP's belief about it, and the share of missions in
    their leave-one-out 95 % intervals.
``{"kind": "done", "ask_s"}``

Every strategy starts at the problem's default configuration. Our product's rule recommends for all alike: best posterior mean of our GP among the configurations run.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, TextIO

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

import tuner.problem.problem  # noqa: E402
from research.optimiser_problems import ROCKS, Problem, make_problem  # noqa: E402
from research.optimiser_strategies import STRATEGIES, applicable  # noqa: E402
from tuner.problem.instances import Instance  # noqa: E402
from tuner.problem.observations import (  # noqa: E402
    Observation,
    Proposal,
    distinct_configurations,
    next_block,
)
from tuner.problem.search_space import Values  # noqa: E402
from tuner.recommendation.choose import may_be_recommended  # noqa: E402
from tuner.surrogate.model import InstanceMeanGP  # noqa: E402

OUT = Path("runs/optimiser_comparison")
# Shares of the budget at which a recommendation is made; ours more often, to see when it reaches a peer's last:
# every second mission of 64 in the first half of the budget, and at the peers' places.
CHECKPOINTS = (0.2, 0.4, 0.6, 0.8, 1.0)
OUR_CHECKPOINTS = tuple(sorted({*CHECKPOINTS, 0.7, 0.9, *(i / 32 for i in range(2, 17))}))


def result_file(out: Path, problem: str, strategy: str, seed: int) -> Path:
    """Where one run is written."""
    return out / f"{problem}__{strategy}__{seed}.jsonl".replace("/", "-").replace(":", "-")


def complete(path: Path) -> bool:
    """Whether the run in ``path`` came to its end."""
    return path.is_file() and '"kind": "done"' in path.read_text()


def common_recommendation(
    problem: Problem, history: Sequence[Observation], *, ours: bool
) -> tuple[Values, float, float, InstanceMeanGP]:
    """Best posterior mean among the configurations run, its mean and sd, and the model.

    Ours, as in the product, only of what has run on two rocks and replicates, once its last missions see to that.
    """
    instances = tuple(map(Instance, problem.rocks))
    model = InstanceMeanGP(problem.space, history, instances)
    configurations = distinct_configurations(problem.space, model.observations)
    belief = model.posterior(configurations)
    asked = tuner.problem.problem.Problem(problem.space, instances, problem.default, problem.replicates)
    allowed = may_be_recommended(asked, history, configurations)
    if not ours or sum(allowed) < 2:
        allowed = [True] * len(configurations)
    i = int(np.where(allowed, belief.mean, -np.inf).argmax())
    return configurations[i], float(belief.mean[i]), float(belief.sd[i]), model


def play(problem: Problem, name: str, seed: int, log: TextIO, *, end_only: bool = False) -> None:
    """One run, written line by line; with ``end_only`` it recommends at the end alone, which where seeds differ saves half."""

    def write(kind: str, **fields: Any) -> None:
        print(json.dumps({"kind": kind, **fields}), file=log, flush=True)

    write(
        "run",
        problem=problem.name,
        strategy=name,
        seed=seed,
        budget=problem.budget,
        dimension=problem.space.dimension,
        rocks=list(problem.rocks),
        best=problem.best,
        default_truth=problem.truth(problem.default),
    )
    strategy = STRATEGIES[name](problem, seed)
    instances = tuple(map(Instance, problem.rocks))
    history: list[Observation] = []
    spent = total_ask_s = 0.0
    shares = OUR_CHECKPOINTS if name.startswith("gp") else CHECKPOINTS
    marks = [share * problem.budget for share in (CHECKPOINTS[-1:] if end_only else shares)]
    while spent < problem.budget - 1e-6:
        began = time.process_time()
        request = strategy.ask()
        ask_s = time.process_time() - began
        total_ask_s += ask_s
        instance = None if request.rock is None else Instance(request.rock)
        proposal = Proposal(request.values, {}, instance, request.replicate)
        (rock, _), replicate = next_block(instances, problem.replicates, history, proposal)
        flight = problem.run(request.values, rock, replicate)
        spent += flight.cost
        observation = Observation(len(history), request.values, rock, replicate, flight.value, flight.value)
        history.append(observation)
        strategy.tell(observation)
        write(
            "mission",
            cost=round(spent, 6),
            values=dict(request.values),
            rock=rock,
            replicate=replicate,
            value=flight.value,
            ask_s=round(ask_s, 4),
        )
        if (
            marks
            and spent >= marks[0] - 1e-6
            and any(o.feasible and o.rock in problem.rocks for o in history)
        ):
            while marks and spent >= marks[0] - 1e-6:
                marks.pop(0)
            full = [o for o in history if o.rock in problem.rocks]
            values, mean, sd, model = common_recommendation(problem, full, ours=name.startswith("gp"))
            write(
                "checkpoint",
                cost=round(spent, 6),
                values=dict(values),
                truth=problem.truth(values),
                mean=mean,
                sd=sd,
                loo=model.leave_one_out()["coverage_95"],
            )
    write("done", ask_s=total_ask_s)


def run_one(job: tuple[str, str, int, Path, tuple[str, ...], int | None], end_only: bool = False) -> str:
    """One run in a process of its own; returns a line for people."""
    problem_name, strategy, seed, out, rocks, budget = job
    path = result_file(out, problem_name, strategy, seed)
    began = time.monotonic()
    problem = make_problem(problem_name, seed, out / "geometric_missions.sqlite", rocks, budget)
    with path.open("w") as log:
        play(problem, strategy, seed, log, end_only=end_only)
    last = [json.loads(line) for line in path.read_text().splitlines() if '"checkpoint"' in line][-1]
    return f"{problem_name:24s} {strategy:14s} {seed:3d}  {last['truth']:8.3f}  {time.monotonic() - began:5.0f} s"


def main() -> None:
    """Parse, play or summarise."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run")
    run.add_argument("--problem", nargs="+", required=True)
    run.add_argument("--strategy", nargs="+", default=list(STRATEGIES))
    run.add_argument("--seeds", type=int, default=10)
    run.add_argument("--first-seed", type=int, default=0)
    run.add_argument("--budget", type=int)
    run.add_argument("--rocks", nargs="+", default=list(ROCKS), help="of geometric problems: names or meshes")
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument("--end-only", action="store_true", help="recommend at the end alone")
    run.add_argument("--out", type=Path, default=OUT)
    summary = commands.add_parser("summary")
    summary.add_argument("--out", type=Path, default=OUT)
    summary.add_argument("--ours", default="gp")
    summary.add_argument("--problem", nargs="+")
    summary.add_argument("--strategy", nargs="+")
    arguments = parser.parse_args()
    if arguments.command == "summary":
        from research.optimiser_summary import summarise

        summarise(arguments.out, arguments.ours, arguments.problem, arguments.strategy)
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    jobs = [
        (problem, strategy, seed, arguments.out, tuple(arguments.rocks), arguments.budget)
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds)
        for problem in arguments.problem
        for strategy in arguments.strategy
        if applicable(strategy, problem) and not complete(result_file(arguments.out, problem, strategy, seed))
    ]
    if arguments.jobs == 1:
        for job in jobs:
            print(run_one(job, arguments.end_only), flush=True)
        return
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for line in pool.map(functools.partial(run_one, end_only=arguments.end_only), jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
