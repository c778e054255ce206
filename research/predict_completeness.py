"""Fits the calibration of `nbv.scorers.prediction`, and says how well the dense cloud's completeness is predicted.

    python -m research.predict_completeness fit --rocks 6
    python -m research.predict_completeness check --split held-out --first 4 --rocks 5 --out predicted.csv

States of geometric missions: orbits, and the adaptive plan on its way. The sparse model gives the prediction, the simulator
the completeness at 48 mm of the observable surface. ``fit`` flies rocks of training seeds, prints what is to be put into
`nbv.scorers.prediction.Calibration` by hand, and predicts every rock by a fit without it; ``check`` predicts with what is
there. ``--rocks`` counts seeds of each family. A failed mission is left out.
"""

from __future__ import annotations

import argparse
import csv
import functools
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import spearmanr

from nbv.config import MissionConfig
from nbv.geometric.completeness import predicted_metrics
from nbv.scorers.prediction import Calibration, predict
from nbv.types import Floats, SparseModel
from research.adaptive_plans import base, fly, rocks_of

BINS = 10
BOOTSTRAP = 1000
TWO_RINGS = {"seed.upper_share": 0.36, "seed.span_deg": 25.0}
PLANS: dict[str, dict[str, Any]] = {
    "orbit-16": {"seed.count": 16},
    "orbit-24": {"seed.count": 24},
    "two-rings-24": {"seed.count": 24, **TWO_RINGS},
    "two-rings-40": {"seed.count": 40, **TWO_RINGS},
    "adaptive": {"seed.count": 12, "stop.adaptive_budget": 36, "gate.kind": "predicted"},
}
ON_THE_WAY = (12, 16, 20, 24, 28, 32, 40, 48)
HEAD = ("rock", "plan", "photographs", "completeness", "weakest", "height_m", "predicted")


def states(rock: str) -> list[dict[str, Any]]:
    """Every orbit's end, and the adaptive plan after so many photographs."""
    rows: list[dict[str, Any]] = []

    def look(name: str, reconstructor: Any, model: SparseModel, believed: MissionConfig) -> None:
        if len(model.camera_names) not in ON_THE_WAY:
            return
        made = predict(model.points_m, model.camera_centers_m, believed)
        real = predicted_metrics(reconstructor._world, reconstructor.predicted(), believed)["observable"]
        values = (
            rock,
            name,
            len(model.camera_names),
            real["completeness_48mm"] / 100.0,
            made.weakest,
            made.height_m,
            made.completeness,
        )
        rows.append(dict(zip(HEAD, values, strict=True)))

    for name, planned in PLANS.items():
        result = fly(base(**planned), rock, listen=functools.partial(look, name)).result
        if result.status == "failed":
            print(f"{rock} {name}: {result.reason}", flush=True)
    return rows


def column(rows: list[dict[str, Any]], name: str) -> Floats:
    return np.array([row[name] for row in rows], dtype=float)


def log_odds(share: Floats) -> Floats:
    inside = np.clip(share, 0.005, 0.995)
    return np.asarray(np.log(inside / (1.0 - inside)))


def features(rows: list[dict[str, Any]]) -> Floats:
    """(N, 3) what the calibration weighs."""
    return np.column_stack(
        [np.ones(len(rows)), log_odds(column(rows, "weakest")), np.log(column(rows, "height_m"))]
    )


def fit(rows: list[dict[str, Any]]) -> Floats:
    """(3,) weights: least squares of the completeness."""
    x, real = features(rows), column(rows, "completeness")
    return np.asarray(least_squares(lambda w: 1.0 / (1.0 + np.exp(-x @ w)) - real, [0.0, 1.0, 0.0]).x)


def predict_without_the_rock(rows: list[dict[str, Any]]) -> None:
    """Every state's prediction, by a fit to the other rocks."""
    for rock in {row["rock"] for row in rows}:
        own = [row for row in rows if row["rock"] == rock]
        weights = fit([row for row in rows if row["rock"] != rock])
        for row, value in zip(own, 1.0 / (1.0 + np.exp(-features(own) @ weights)), strict=True):
            row["predicted"] = float(value)


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
    parser.add_argument("--first", type=int, default=0, help="seeds of the split to leave out before")
    parser.add_argument("--out", type=Path, help="CSV of the states")
    arguments = parser.parse_args()
    split = "train" if arguments.what == "fit" else arguments.split
    rows = [row for rock in rocks_of(split, arguments.rocks, arguments.first) for row in states(rock)]
    if arguments.what == "fit":
        print(Calibration(*(round(float(w), 2) for w in fit(rows))))
        predict_without_the_rock(rows)
    family = {row["rock"]: row["rock"].rpartition("-")[0] for row in rows}
    print("\n".join(report(rows)))
    print("without clefts:", *report([row for row in rows if family[row["rock"]] != "cleft"]), sep="\n")
    for name in sorted(set(family.values())):
        own = [row for row in rows if family[row["rock"]] == name]
        off = 100 * (column(own, "predicted") - column(own, "completeness"))
        print(f"{name}: {off.mean():+.1f} points in the mean, {np.abs(off).mean():.1f} absolute")
    if arguments.out is not None:
        with arguments.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, HEAD)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
