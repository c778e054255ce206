"""Fits the calibration of `nbv.scorers.prediction`, and says how well the dense cloud's completeness is predicted.

    python -m research.predict_completeness fit --rocks 6
    python -m research.predict_completeness check --split held-out --rocks 8 --out predicted.csv
    python -m research.predict_completeness check --split validation --rocks 1 --fidelity photogrammetric --plans orbit-12 orbit-20

Each state is what a mission ends with: its sparse model gives the prediction, its cloud the completeness at 48 mm of the
observable surface. ``fit`` flies rocks of training seeds and prints what is to be put into
`nbv.scorers.prediction.Calibration` by hand. ``--rocks`` counts seeds of each family. A failed mission is left out.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import spearmanr

from nbv.scorers.prediction import Calibration, predict
from nbv.types import Floats
from research.adaptive_plans import fly, known, rocks_of

BINS = 10
BOOTSTRAP = 1000
TWO_RINGS = {"seed.upper_share": 0.36, "seed.span_deg": 25.0}
PLANS: dict[str, dict[str, Any]] = {
    "orbit-12": {"seed.count": 12},
    "orbit-16": {"seed.count": 16},
    "orbit-20": {"seed.count": 20},
    "orbit-26": {"seed.count": 26},
    "orbit-32": {"seed.count": 32},
    "two-rings-20": {"seed.count": 20, **TWO_RINGS},
    "two-rings-32": {"seed.count": 32, **TWO_RINGS},
    "two-rings-48": {"seed.count": 48, **TWO_RINGS},
    "12+8-random": {"seed.count": 12, "stop.adaptive_budget": 8, "gate.kind": "random"},
    "12+20-random": {"seed.count": 12, "stop.adaptive_budget": 20, "gate.kind": "random"},
    "12+8": {"seed.count": 12, "stop.adaptive_budget": 8, "gate.kind": "predicted"},
    "16+16": {"seed.count": 16, "stop.adaptive_budget": 16, "gate.kind": "predicted"},
}
HEAD = (
    "rock",
    "plan",
    "fidelity",
    "photographs",
    "completeness",
    "chance",
    "observable",
    "height_m",
    "predicted",
)


def states(rocks: list[str], fidelity: str, plans: list[str]) -> list[dict[str, Any]]:
    """One row for each mission."""
    rows = []
    for rock in rocks:
        for plan in plans:
            flown = fly(known(rock, **PLANS[plan]), rock, fidelity)
            if flown.result.status == "failed" or flown.model is None:
                print(f"{rock} {plan}: {flown.result.reason}", flush=True)
                continue
            made = predict(flown.model.points_m, flown.model.camera_centers_m, flown.believed)
            values = (
                rock,
                plan,
                fidelity,
                len(flown.model.camera_names),
                flown.result.metric("observable.completeness_48mm") / 100.0,
                float(made.chance.mean()),
                made.observable_share,
                made.height_m,
                made.completeness,
            )
            rows.append(dict(zip(HEAD, values, strict=True)))
    return rows


def column(rows: list[dict[str, Any]], name: str) -> Floats:
    return np.array([row[name] for row in rows], dtype=float)


def log_odds(share: Floats) -> Floats:
    inside = np.clip(share, 0.005, 0.995)
    return np.asarray(np.log(inside / (1.0 - inside)))


def fit(rows: list[dict[str, Any]]) -> Calibration:
    """Least squares of the completeness."""
    features = np.column_stack(
        [
            np.ones(len(rows)),
            log_odds(column(rows, "chance")),
            log_odds(column(rows, "observable")),
            np.log(column(rows, "height_m")),
        ]
    )
    real = column(rows, "completeness")
    found = least_squares(lambda w: 1.0 / (1.0 + np.exp(-features @ w)) - real, [0.0, 1.0, 0.0, 0.0])
    return Calibration(*(float(w) for w in found.x))


def calibration_error(predicted: Floats, real: Floats) -> float:
    """Mean over bins of equally many states of how far the mean prediction is from the mean outcome."""
    bins = np.array_split(np.argsort(predicted, kind="stable"), BINS)
    return float(np.mean([abs(predicted[b].mean() - real[b].mean()) for b in bins if len(b)]))


def report(rows: list[dict[str, Any]]) -> list[str]:
    """Rank correlation, calibration error and mean absolute error, with 95 % bootstrap intervals over rocks."""
    rocks = sorted({row["rock"] for row in rows})
    of_rock = {rock: [row for row in rows if row["rock"] == rock] for rock in rocks}
    measures = {
        "rank correlation": lambda p, y: float(spearmanr(p, y).statistic),
        "calibration error (points)": lambda p, y: 100.0 * calibration_error(p, y),
        "mean absolute error (points)": lambda p, y: 100.0 * float(np.abs(p - y).mean()),
    }
    lines = [f"{len(rows)} states of {len(rocks)} rocks"]
    rng = np.random.default_rng(0)
    draws = [
        [row for k in rng.integers(0, len(rocks), len(rocks)) for row in of_rock[rocks[k]]]
        for _ in range(BOOTSTRAP)
    ]
    for name, measure in measures.items():
        value = measure(column(rows, "predicted"), column(rows, "completeness"))
        each = [measure(column(draw, "predicted"), column(draw, "completeness")) for draw in draws]
        low, high = np.nanpercentile(each, [2.5, 97.5])
        lines.append(f"{name}: {value:.2f} [{low:.2f}, {high:.2f}]")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=("fit", "check"))
    parser.add_argument("--split", choices=("train", "validation", "held-out"), default="train")
    parser.add_argument("--rocks", type=int, default=6, help="seeds of each family")
    parser.add_argument("--fidelity", choices=("geometric", "photogrammetric"), default="geometric")
    parser.add_argument("--plans", nargs="+", choices=PLANS, default=list(PLANS))
    parser.add_argument("--out", type=Path, help="CSV of the states")
    arguments = parser.parse_args()
    split = "train" if arguments.what == "fit" else arguments.split
    rows = states(rocks_of(split, arguments.rocks), arguments.fidelity, arguments.plans)
    if arguments.what == "fit":
        print(fit(rows))
        for row in rows:
            row["predicted"] = float("nan")
    else:
        print("\n".join(report(rows)))
        families = sorted({row["rock"].rpartition("-")[0] for row in rows})
        for family in families:
            of_family = [row for row in rows if row["rock"].startswith(family)]
            off = column(of_family, "predicted") - column(of_family, "completeness")
            print(
                f"{family}: {100 * off.mean():+.1f} points in the mean, {100 * np.abs(off).mean():.1f} absolute"
            )
    if arguments.out is not None:
        with arguments.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, HEAD)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
