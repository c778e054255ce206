"""A configuration tuned in ``ideal`` and one tuned over conditions, run on held-out rocks in conditions neither has seen.

    OMP_NUM_THREADS=1 python -m research.unseen_conditions --ideal runs/ideal --worlds runs/worlds \\
        --condition harsh low-sun --rock arch fin cairn spire cleft $HELD_OUT --out runs/unseen --data unseen_conditions.csv

Both campaigns' recommendations, Hyb-H at the paper's values, and random views in the second one's pool; with ``--there RUN``
what a campaign in these very conditions recommends, which bounds what tuning over others can bring. Goes on where it stopped. Writes a row per mission and prints paired differences with 95 % intervals over rocks (Student's t).
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import stats

from nbv.config import load_conditions
from tuner.campaign.campaign import Campaign
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.run import run_evaluation
from tuner.missions.executors import LocalProcessExecutor

PAPER, IDEAL, WORLDS, CHANCE = "hyb-h", "tuned-ideal", "tuned-conditions", "random-in-its-pool"
THERE = "tuned-there"
PAIRS = ((WORLDS, IDEAL), (IDEAL, PAPER), (WORLDS, PAPER), (WORLDS, CHANCE), (THERE, IDEAL), (THERE, PAPER))
METRICS = ("f_score_48mm", "completeness_48mm", "accuracy_48mm", "c2c_mean_mm")


def main() -> None:
    """Run what is not run yet, then tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--ideal", type=Path, required=True)
    parser.add_argument("--worlds", type=Path, required=True)
    parser.add_argument("--there", type=Path, help="a campaign in the condition itself")
    parser.add_argument("--strategies", nargs="+", help="of these alone (default: all)")
    parser.add_argument("--condition", nargs="+", required=True)
    parser.add_argument("--rock", nargs="+", required=True)
    parser.add_argument("--replicates", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    arguments = parser.parse_args()
    ideal, instances = (Campaign.open(run, read_only=True) for run in (arguments.ideal, arguments.instances))
    base, tuned = ideal.settings.problem.base, instances.recommended_config()
    chance = base.with_values({"gate.kind": "random", "pool.max_altitude_m": tuned.pool.max_altitude_m})
    configs = {
        PAPER: base.with_values({"gate.kind": "hyb-h"}),
        IDEAL: ideal.recommended_config(),
        WORLDS: tuned,
        CHANCE: chance,
    }
    if arguments.there:
        configs[THERE] = Campaign.open(arguments.there, read_only=True).recommended_config()
    if arguments.strategies:
        configs = {name: configs[name] for name in arguments.strategies}
    plan = EvaluationPlan(
        configs, tuple(arguments.rock), arguments.replicates, conditions=load_conditions(arguments.condition)
    )
    with LocalProcessExecutor(arguments.workers) as executor:
        run = run_evaluation(
            plan, arguments.out, executor, lambda e: print(e.kind, e.finished, e.total, flush=True)
        )
    head = ("strategy", "rock", "condition", "replicate", "status", *METRICS)
    values: dict[tuple[str, str, str], list[float]] = {}
    with arguments.data.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(head)
        for record in run.records:
            rock, condition = Path(record.rock).stem, record.condition
            found = [record.value(f"registered.observable.{metric}") for metric in METRICS]
            shown = ["" if value is None else f"{value:.3f}" for value in found]
            status = record.reason or record.record.status
            rows.writerow([record.strategy, rock, condition, record.replicate, status, *shown])
            # A failed mission leaves its rock out of a pair; how many there are is printed.
            values.setdefault((record.strategy, rock, condition), []).append(
                np.nan if found[0] is None else found[0]
            )
    tell({key: float(np.mean(v)) for key, v in values.items()}, arguments.condition)


def tell(values: Mapping[tuple[str, str, str], float], conditions: list[str]) -> None:
    """Mean F-score per condition, and paired differences of rock means."""
    rocks, evaluated = (
        sorted({rock for _, rock, _ in values}),
        sorted({strategy for strategy, _, _ in values}),
    )
    for group in ([condition] for condition in conditions):
        means = {s: np.nanmean([values[s, r, group[0]] for r in rocks]) for s in evaluated}
        print(group[0], {name: round(float(mean), 2) for name, mean in means.items()})
    for group in (*([condition] for condition in conditions), conditions):
        for a, b in (pair for pair in PAIRS if set(pair) <= set(evaluated)):
            per_rock = np.array([np.mean([values[a, r, c] - values[b, r, c] for c in group]) for r in rocks])
            kept = per_rock[np.isfinite(per_rock)]
            half = stats.t.ppf(0.975, len(kept) - 1) * stats.sem(kept)
            print(
                f"{'+'.join(group):20} {a} - {b}: {kept.mean():+.2f} [{kept.mean() - half:+.2f}, "
                f"{kept.mean() + half:+.2f}] on {len(kept)} rocks"
            )


if __name__ == "__main__":
    main()
