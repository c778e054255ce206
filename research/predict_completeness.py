"""Fits the calibration of `nbv.scorers.prediction`, and says how well the dense cloud's completeness is predicted.

    python -m research.predict_completeness fit --rocks 6
    python -m research.predict_completeness shapes kept --out shapes.csv
    python -m research.predict_completeness gains part-20001 head-20000 --out gains.csv

States of geometric missions: orbits, and plans on their way; completeness at 48 mm of the observable surface. ``fit`` prints the
`nbv.scorers.prediction.Calibration` of training rocks and shapes, and predicts every rock by a fit without it; ``shapes`` predicts
those of `research.other_shapes`. ``gains`` flies missions with photographs in `indoors`, and compares what *predicted* promises of
each with what the dense cloud gets by it. A failed mission is left out.
"""

from __future__ import annotations

import argparse
import functools
import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import spearmanr

from nbv.config import MissionConfig, load_condition, under
from nbv.dense.reconstruct import dense_cloud
from nbv.evaluation import evaluate_cloud
from nbv.geometric.completeness import predicted_metrics
from nbv.geometry.stereo_chance import reconstruction_probability
from nbv.rocks import load_rock
from nbv.rocks.families import EVERY
from nbv.scorers import prediction
from nbv.scorers.prediction import LEAST_UNKNOWN, Calibration, Prediction, predict
from nbv.types import Floats, SparseModel
from research import write_rows
from research.adaptive_plans import base, rocks_of, run_missions
from research.known_surface import true_solid
from research.other_shapes import KEPT, LATER, SEEN
from research.planned_photographs import plans
from tuner.problem.intervals import mean_interval

NEVER = {"stop.criterion": "predicted", "stop.predicted_percent": 100.0}  # stops, but depth is asked for
TWO_RINGS = {"seed.upper_share": 0.36, "seed.span_deg": 25.0}
PLANS: dict[str, dict[str, Any]] = {
    "orbit-16": {"photographs": 16, "seeds": 16},
    "orbit-24": {"photographs": 24, "seeds": 24},
    "two-rings-24": {"photographs": 24, "seeds": 24, **TWO_RINGS},
    "two-rings-40": {"photographs": 40, "seeds": 40, **TWO_RINGS},
    "adaptive": {"photographs": 48, "seeds": 12, "gate.kind": "predicted"},
    "random": {"photographs": 48, "seeds": 12, "gate.kind": "random"},  # to compare with
}
ON_THE_WAY = (12, 16, 20, 24, 28, 32, 40, 48)
HEAD = ("rock", "plan", "photographs", "completeness", "mean_chance", "unknown", "predicted")
TEN_SEEDS = "10 seeds on the paper's rings, by *predicted*"
# What is promised of a photograph: as flown, from the place that was planned, without what has matched so far, by the rules of the
# dense stage, on the true surface (GROUND TRUTH).
PROMISES = ("promised", "at_plan", "unmatched", "by_rules", "true_surface")
GAINS_HEAD = ("shape", "photograph", *PROMISES, "got")
TOLD_FROM = 16
BELOW = 0.25  # share of the states with less than is said
SETS = {"seen": SEEN, "kept": KEPT, "later": LATER}


def states(rock: str) -> list[dict[str, Any]]:
    """Every orbit's end, and plans after so many photographs."""
    rows: list[dict[str, Any]] = []

    def look(name: str, reconstructor: Any, model: SparseModel, believed: MissionConfig) -> None:
        if len(model.camera_names) not in ON_THE_WAY:
            return
        made = predict(model, believed)
        real = predicted_metrics(reconstructor._world, reconstructor.predicted(), believed)["observable"]
        values = (
            rock,
            name,
            len(model.camera_names),
            real["completeness_48mm"] / 100.0,
            made.mean_chance,
            made.unknown,
            made.completeness,
        )
        rows.append(dict(zip(HEAD, values, strict=True)))

    for name, planned in PLANS.items():
        result = run_missions(base(**planned, **NEVER), rock, listen=functools.partial(look, name)).result
        if result.status == "failed":
            print(f"{rock} {name}: {result.reason}", flush=True)
    return rows


def gains(shape: str, photographs: int = 24) -> list[dict[str, Any]]:
    """Of each planned photograph of a mission from ten seeds the `PROMISES`, and what the completeness at 48 mm gains by it."""
    config = under(base(**plans(photographs)[TEN_SEEDS]), load_condition("indoors"))
    rock, rows, before = load_rock(shape), list[dict[str, Any]](), list[Any]()
    solid, carved = true_solid(np.asarray(rock.vertices_m), np.asarray(rock.faces)), prediction.carved

    def look(reconstructor: Any, model: SparseModel, believed: MissionConfig) -> None:
        cloud = dense_cloud(reconstructor._views(reconstructor._mapped()))
        got = evaluate_cloud(cloud, rock, config).metrics["observable"]["completeness_48mm"] / 100.0
        made, number, at_m = predict(model, believed), len(model.camera_names), model.camera_centers_m[-1:]
        prediction.carved = lambda *_, **__: solid
        known = predict(model, believed)
        prediction.carved = carved
        if before:
            had_made, had_known, had = before
            alike = replace(had_made, matches=np.ones_like(had_made.matches))
            told = [
                (had_made, at_m),
                (had_made, np.array([reconstructor.planned_m])),
                (alike, at_m),
                (had_known, at_m),
            ]
            values = [p.expected_gain(place)[0] * (1.0 - p.matched).mean() for p, place in told]
            values.insert(3, by_rules(had_made, at_m))
            numbers = (f"{x:.4f}" for x in (*values, got - had))
            rows.append(dict(zip(GAINS_HEAD, (shape, number, *numbers), strict=True)))
        before[:] = made, known, got

    run_missions(config, shape, "photogrammetric", listen=look)
    return rows


def by_rules(made: Prediction, at_m: Floats) -> float:
    """What a further photograph from (1, 3) adds to the share that `nbv.geometry.stereo_chance` expects."""
    cameras_m = np.concatenate([made.model.camera_centers_m, at_m - [0.0, 0.0, made.config.target.ground_m]])
    seen, incidence = prediction._visibility(made.samples_m, made.normals, cameras_m, made.config, made.solid)
    contrast = np.full(len(made.samples_m), prediction.CONTRAST)
    of = seen, incidence, contrast, made._directions(cameras_m), made.config.dense
    after = reconstruction_probability(*of, prediction.ANGLE_DECAY_PER_DEG)
    return float(after.mean() - made.chance.mean())


def report_gains(rows: list[dict[str, Any]]) -> list[str]:
    """Means over shapes of rank correlations over photographs, also with the order held fixed; means by what was promised, in points."""
    of, got = np.array([row["shape"] for row in rows]), 100.0 * column(rows, "got")
    promised, lines, first = 100.0 * column(rows, "promised"), list[str](), list[tuple[float, float, float]]()
    for name in (name for name in PROMISES if name in rows[0]):
        told, each = column(rows, name), list[tuple[float, float, float]]()
        for shape in dict.fromkeys(of):
            p, g = told[of == shape], got[of == shape]
            order = -np.arange(len(g))
            both, p_order, g_order = (spearmanr(*pair).statistic for pair in ((p, g), (p, order), (g, order)))
            fixed = (both - p_order * g_order) / np.sqrt((1.0 - p_order**2) * (1.0 - g_order**2))
            each.append((both, g_order, fixed))
        means, low, high = np.mean(each, axis=0), np.min(each, axis=0), np.max(each, axis=0)
        first = each if name == PROMISES[0] else first
        gap = mean_interval({str(k): [x[2] - y[2]] for k, (x, y) in enumerate(zip(first, each))})
        lines.append(
            f"{name}: rank correlation {means[0]:.2f} ({low[0]:.2f} to {high[0]:.2f}), with the order held fixed {means[2]:.2f}"
            f" (promised minus this: {gap and f'{gap.mean:.2f} [{gap.low:.2f}, {gap.high:.2f}]'}), of the order alone {means[1]:.2f}; sum {100.0 * told.sum() / len(each):.1f},"
            f" got {got.sum() / len(each):.1f}"
        )
    for low_, high_ in itertools.pairwise((0.0, 1.0, 2.0, 4.0, 100.0)):
        part = (promised >= low_) & (promised < high_)
        if part.any():
            means = promised[part].mean(), got[part].mean()
            lines.append(
                "{} promise {:g} to {:g}: {:.1f}, got {:.1f}".format(part.sum(), low_, high_, *means)
            )
    return lines


def column(rows: list[dict[str, Any]], name: str) -> Floats:
    return np.array([row[name] for row in rows], dtype=float)


def log_odds(share: Floats) -> Floats:
    inside = np.clip(share, 0.005, 0.995)
    return np.asarray(np.log(inside / (1.0 - inside)))


def features(rows: list[dict[str, Any]]) -> Floats:
    """(N, 3) what the calibration weighs."""
    unknown = np.log(column(rows, "unknown") + LEAST_UNKNOWN)
    return np.column_stack([np.ones(len(rows)), log_odds(column(rows, "mean_chance")), unknown])


def fit(rows: list[dict[str, Any]]) -> Floats:
    """(3,) weights: least squares of the completeness, then an intercept so low that `BELOW` of the states have less."""
    x, real = features(rows), column(rows, "completeness")
    weights = np.asarray(least_squares(lambda w: 1.0 / (1.0 + np.exp(-x @ w)) - real, [0.0, 1.0, -0.5]).x)
    weights[0] += np.quantile(log_odds(real) - x @ weights, BELOW)
    return weights


def predict_without_the_rock(rows: list[dict[str, Any]]) -> None:
    """Every state's prediction, by a fit to the other rocks."""
    for rock in {row["rock"] for row in rows}:
        own = [row for row in rows if row["rock"] == rock]
        weights = fit([row for row in rows if row["rock"] != rock])
        for row, value in zip(own, 1.0 / (1.0 + np.exp(-features(own) @ weights)), strict=True):
            row["predicted"] = float(value)


def percent(rows: list[dict[str, Any]], name: str) -> Floats:
    """(N,) F-scores of completenesses, every point taken for right."""
    return 200.0 * column(rows, name) / (1.0 + column(rows, name))


def too_high(rows: list[dict[str, Any]]) -> list[str]:
    """How often the F-score is predicted too high from `TOLD_FROM` photographs on, and what is reached where it says 98."""
    rows = [row for row in rows if int(row["photographs"]) >= TOLD_FROM]
    over, done = percent(rows, "predicted") - percent(rows, "completeness"), percent(rows, "predicted") >= 98
    reached = percent(rows, "completeness")[done] >= 97
    return [
        f"{len(rows)} states with {TOLD_FROM} photographs and more: more than 5 points too high {(over > 5).mean():.3f},"
        f" nine of ten at most {np.quantile(over, 0.9):+.1f}; 98 predicted {done.sum()} times, 97 reached"
        f" {reached.sum()} times"
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=("fit", "shapes", "gains"))
    parser.add_argument("which", nargs="*", help="shapes: one of seen, kept, later; gains: names")
    parser.add_argument("--rocks", type=int, default=6, help="seeds of each family")
    parser.add_argument("--out", type=Path, help="CSV of the states")
    arguments = parser.parse_args()
    if arguments.what == "shapes" and (unknown := {*arguments.which} - {*SETS}):
        parser.error(f"no set of shapes is called {sorted(unknown)[0]}; there are {', '.join(SETS)}")
    if arguments.what == "gains":
        rows = [row for shape in arguments.which for row in gains(shape)]
        print("\n".join(report_gains(rows)))
        if arguments.out is not None:
            write_rows(arguments.out, GAINS_HEAD, rows)
        return
    if arguments.what == "fit":
        names = [*rocks_of("train", arguments.rocks, 0, EVERY), *(make.__name__ for make in SEEN)]
    else:
        names = [make.__name__ for which in arguments.which or ["kept"] for make in SETS[which]]
    rows = [row for name in names for row in states(name)]
    if arguments.what == "fit":
        print(Calibration(*(round(float(w), 2) for w in fit(rows))))
        predict_without_the_rock(rows)
    print("\n".join(too_high(rows)))
    if arguments.out is not None:
        write_rows(arguments.out, HEAD, rows)


if __name__ == "__main__":
    main()
