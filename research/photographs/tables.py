"""The tables of docs/results/real_photographs.md, from what `research.photographs.fly` flew.

python -m research.photographs.tables OUT [OUT ...]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from tuner.evaluation.plan import EvaluationPlan
from tuner.evaluation.statistics import mean_interval
from tuner.missions.job import Trial

F_SCORE, PHOTOMETRIC = "observable.f_score_48mm", "kept_out.photometric_error_percent"
PAIRS = (("matchable", "random"), ("oracle", "random"), ("hyb-h", "random"))


def main() -> None:
    """Markdown on standard output."""
    for out in map(Path, sys.argv[1:]):
        trials = EvaluationPlan.load(out).records(out)
        print(f"\n{out.name}: {len(trials)} missions\n")
        print(
            "|plan|missions|photographs|registered|F-score|kept out: registered, %|covered, %|photometric, %|"
        )
        print("|---|---:|---:|---:|---:|---:|---:|---:|")
        for name in dict.fromkeys(t.strategy for t in trials):
            of = [t for t in trials if t.strategy == name]
            columns = ("costs.images", "costs.registered_images", F_SCORE, "kept_out.registered_percent")
            values = [mean(of, key) for key in (*columns, "kept_out.covered_percent", PHOTOMETRIC)]
            print(f"|{name}|{len(of)}|" + "|".join(f"{value:.1f}" for value in values) + "|")
        for better, worse in PAIRS:
            for number in dict.fromkeys(t.strategy.partition("-")[2] for t in trials):
                say_difference(trials, f"{better}-{number}", f"{worse}-{number}")
        both = [(t.value(F_SCORE), t.value(PHOTOMETRIC)) for t in trials]
        pairs = np.array([pair for pair in both if None not in pair], dtype=float)
        if len(pairs) > 2:
            rank = spearmanr(pairs[:, 0], -pairs[:, 1]).statistic
            print(f"rank correlation of F-score and photometric error over {len(pairs)} missions: {rank:.2f}")


def mean(trials: list[Trial], key: str) -> float:
    """Over those that have it."""
    values = [value for t in trials if (value := t.value(key)) is not None]
    return float(np.mean(values)) if values else float("nan")


def say_difference(trials: list[Trial], better: str, worse: str) -> None:
    """Paired by replicate; a failed mission counts 0."""
    a, b = (
        {t.replicate: t.value(F_SCORE) or 0.0 for t in trials if t.strategy == name}
        for name in (better, worse)
    )
    found = mean_interval({"set": [a[k] - b[k] for k in sorted(a.keys() & b.keys())]})
    if found is not None:
        bounds = "" if found.low is None else f" [{found.low:+.1f}, {found.high:+.1f}]"
        print(f"{better} over {worse}: {found.mean:+.1f}{bounds}, {found.missions} pairs")


if __name__ == "__main__":
    main()
