"""The tables of docs/results/real_photographs.md, from what `research.photographs.fly` flew.

python -m research.photographs.tables OUT [OUT ...] [--csv FILE]
"""

from __future__ import annotations

import argparse
import csv
import itertools
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from tuner.evaluation.comparison import mean_interval
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial

F_SCORE, STRICT = "observable.f_score_48mm", "observable.f_score_16mm"
KEPT, PHOTOMETRIC = "kept_out.covered_percent", "kept_out.photometric_error_percent"
COLUMNS = ("costs.images", "costs.registered_images", F_SCORE, STRICT, KEPT, PHOTOMETRIC)
RANDOM = {"16+8": "random-16+8", "8+11-low": "random-8+11-low"}


def main() -> None:
    """Markdown on standard output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, nargs="+")
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    trials = [trial for out in asked.out for trial in EvaluationPlan.load(out).records(out)]
    of_rock = {rock: [t for t in trials if t.rock == rock] for rock in sorted({t.rock for t in trials})}
    for rock, flown in of_rock.items():
        print(f"\n{rock}: {len(flown)} missions, {sum(t.status == 'failed' for t in flown)} failed\n")
        print(
            "|plan|missions|photographs|registered|F-score|F-score at 1 %|covered, %|photometric error, %|over random|"
        )
        print("|---|---:|---:|---:|---:|---:|---:|---:|---|")
        for name in dict.fromkeys(t.strategy for t in flown):
            of = [t for t in flown if t.strategy == name]
            values = "|".join(f"{mean(of, key):.1f}" for key in COLUMNS)
            random = RANDOM.get(name.partition("-")[2] if not name.startswith(("b-aware", "hyb")) else "16+8")
            print(f"|{name}|{len(of)}|{values}|{difference(flown, name, random)}|")
        both = np.array([(quality(t), t.value(PHOTOMETRIC) or np.nan) for t in flown], dtype=float)
        both = both[np.isfinite(both).all(axis=1)]
        if len(both) > 2:
            rank = spearmanr(both[:, 0], -both[:, 1]).statistic
            print(f"rank correlation of F-score and photometric error over {len(both)} missions: {rank:.2f}")
    for first, second in itertools.combinations(of_rock, 2):
        say_rank(first, of_rock[first], second, of_rock[second])
    if asked.csv:
        write(asked.csv, trials)


def quality(trial: Trial) -> float:
    """A failed mission counts 0."""
    return trial.value(F_SCORE) or 0.0


def mean(trials: list[Trial], key: str) -> float:
    """Over those that have it."""
    values = [value for t in trials if (value := t.value(key)) is not None]
    return float(np.mean(values)) if values else float("nan")


def difference(trials: list[Trial], better: str, worse: str | None) -> str:
    """Of the F-score, paired by replicate."""
    a, b = ({t.replicate: quality(t) for t in trials if t.strategy == name} for name in (better, worse))
    found = mean_interval({"set": [a[k] - b[k] for k in sorted(a.keys() & b.keys())]})
    if worse is None or better == worse or found is None:
        return ""
    bounds = "" if found.low is None else f" [{found.low:+.1f}, {found.high:+.1f}]"
    return f"{found.mean:+.1f}{bounds}"


def say_rank(first: str, a: list[Trial], second: str, b: list[Trial]) -> None:
    """Of the configurations that both have flown, by their mean F-score."""
    names = sorted({t.strategy for t in a} & {t.strategy for t in b})
    if len(names) > 2:
        means = [[np.mean([quality(t) for t in of if t.strategy == n]) for n in names] for of in (a, b)]
        print(
            f"rank correlation of {len(names)} configurations, {first} and {second}: {spearmanr(*means).statistic:.2f}"
        )


def write(path: Path, trials: list[Trial]) -> None:
    """A row per mission."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["rock", "plan", "replicate", "status", *(c.rpartition(".")[2] for c in COLUMNS)])
        for t in sorted(trials, key=lambda t: (t.rock, t.strategy, t.replicate)):
            values = [t.value(key) for key in COLUMNS]
            writer.writerow(
                [
                    t.rock,
                    t.strategy,
                    t.replicate,
                    t.status,
                    *("" if v is None else f"{v:.2f}" for v in values),
                ]
            )


if __name__ == "__main__":
    main()
