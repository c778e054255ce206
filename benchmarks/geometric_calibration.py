"""How well geometric missions rank configurations, against photogrammetric missions.

    OMP_NUM_THREADS=1 python benchmarks/geometric_calibration.py runs/geometric_calibration --workers 2

Flies spread-out configurations (the paper's strategies and the controls, then a Sobol sequence over gate
thresholds, both scorers' weights, visibility mode and gate kind) with real photogrammetry, in processes of
their own; stop it at any time and start it again to go on. Then:

1. fits the free constants of the stand-in's dense stage on the calibration rocks (grid search on the views
   that the photogrammetric missions chose, so planning plays no part);
2. flies the same configurations geometrically, with the constants in the code and with the fitted ones;
3. prints Spearman's rank correlations per rock and for the mean over rocks, for both groups of rocks, and
   writes them to a Markdown file.

The fitted constants are printed for `nbv.geometric.completeness.DenseModel`; nothing is changed by itself.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc, spearmanr
from threadpoolctl import threadpool_limits

from nbv.config import MissionConfig, preset
from nbv.geometric import StandIn, predict_views, run_geometric_mission
from nbv.geometric.completeness import DenseModel
from nbv.result import MissionResult
from nbv.run_directory import write_atomic
from tuner.evaluation import EvaluationEvent, EvaluationPlan, run_evaluation
from tuner.executors import Executor, InProcessExecutor, LocalProcessExecutor
from tuner.objective import Objective
from tuner.search_space import load_search_space

FIXED: dict[str, dict[str, Any]] = {
    "hyb-h": {"gate.kind": "hyb-h"},
    "covis": {"gate.kind": "covis"},
    "b-aware": {"gate.kind": "b-aware"},
    "random": {"gate.kind": "random"},
    "uniform-coverage": {"gate.kind": "uniform-coverage"},
    "novelty-only": {"gate.kind": "novelty-only"},
    "movement-only": {"gate.kind": "movement-only"},
}
SOBOL_KINDS = ("hyb-h", "b-aware", "covis")
GRID = {
    "incidence_deg": (68.0, 72.0, 76.0, 80.0),
    "incidence_width_deg": (6.0, 10.0),
    "max_pair_angle_deg": (25.0, 35.0),
    "witness_angle_deg": (45.0, 60.0, 90.0),
    "agreement_offset": (-1.0, 0.0, 1.0),
    "agreement_width": (0.5, 1.2),
}


@dataclass(frozen=True)
class Flight:
    """One photogrammetric mission."""

    configuration: str
    rock: str
    replicate: int
    value: float
    chosen: tuple[str, ...]


def configurations(count: int, base: MissionConfig, seed: int = 0) -> dict[str, MissionConfig]:
    """``count`` named configurations: the fixed ones first, then the Sobol sequence."""
    space = load_search_space("gate_and_weights")
    named = {name: base.with_values(values) for name, values in list(FIXED.items())[:count]}
    n_sobol = count - len(named)
    if n_sobol > 0:
        sampler = qmc.Sobol(space.dimension + 2, seed=seed)
        positions = sampler.random_base2(int(np.ceil(np.log2(n_sobol))))[:n_sobol]
        for i, u in enumerate(positions):
            values = {
                **space.base,
                **space.from_unit(u[:-2]),
                "visibility.mode": "occlusion" if u[-2] < 0.5 else "frustum",
                "gate.kind": SOBOL_KINDS[min(int(u[-1] * len(SOBOL_KINDS)), len(SOBOL_KINDS) - 1)],
            }
            named[f"sobol-{i:02d}"] = base.with_values(values)
    return named


def collect(plan: EvaluationPlan, directory: Path, metric: str) -> list[Flight]:
    """What the photogrammetric missions measured and which views they chose; failed ones are left out."""
    flights = []
    for record in plan.records(directory):
        value = record.value(metric)
        if value is not None:
            trace = MissionResult.load(Path(record.outcome.directory)).trace
            flights.append(Flight(record.strategy, record.rock, record.replicate, value, tuple(t.chosen for t in trace)))  # fmt: skip
    return flights


def correlation(a: Sequence[float], b: Sequence[float]) -> float:
    """Spearman's rank correlation; NaN for fewer than 3 pairs or without any variation."""
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def by_configuration(
    flights: Sequence[Flight], values: Sequence[float], rocks: Sequence[str]
) -> dict[str, float]:
    """Mean over rocks and replicates per configuration; only configurations with every mission."""
    groups: dict[str, list[float]] = {}
    for flight, value in zip(flights, values):
        if flight.rock in rocks:
            groups.setdefault(flight.configuration, []).append(value)
    full = max((len(group) for group in groups.values()), default=0)
    return {name: float(np.mean(group)) for name, group in groups.items() if len(group) == full}


def rock_and_mean_correlations(
    flights: Sequence[Flight], values: Sequence[float], rocks: Sequence[str]
) -> tuple[dict[str, float], float]:
    """Spearman's correlation of ``values`` with the measured ones: per rock, and for the mean over rocks."""
    per_rock = {}
    for rock in rocks:
        pairs = [(by_configuration(flights, v, [rock])) for v in ([f.value for f in flights], values)]
        per_rock[rock] = correlation([pairs[0][k] for k in pairs[0]], [pairs[1][k] for k in pairs[0]])
    measured = by_configuration(flights, [f.value for f in flights], rocks)
    predicted = by_configuration(flights, values, rocks)
    return per_rock, correlation(list(measured.values()), [predicted[k] for k in measured])


def replay(
    flights: Sequence[Flight], configs: dict[str, MissionConfig], metric: str, stand_in: StandIn
) -> list[float]:
    """The prediction for the very views that photogrammetry chose."""
    objective, known = Objective(metric), {}
    values = []
    for f in flights:
        key = (f.rock, f.replicate, frozenset(f.chosen))
        if key not in known:
            metrics = predict_views(configs[f.configuration], f.rock, sorted(f.chosen), f.replicate, stand_in=stand_in)  # fmt: skip
            known[key] = objective.measure(metrics)
        values.append(known[key])
    return [float("nan") if v is None else v for v in values]


def fit(
    flights: Sequence[Flight], configs: dict[str, MissionConfig], metric: str, rocks: Sequence[str]
) -> tuple[DenseModel, float]:
    """The grid's constants with the best mean of the rocks' rank correlations; ties: the smaller bias."""
    mine = [f for f in flights if f.rock in rocks]
    best: tuple[float, float] = (-np.inf, -np.inf)
    chosen = DenseModel()
    for point in itertools.product(*GRID.values()):
        model = replace(DenseModel(), **dict(zip(GRID, point)))
        values = replay(mine, configs, metric, StandIn(dense=model))
        per_rock, _ = rock_and_mean_correlations(mine, values, rocks)
        agreement = float(np.nanmean([-1.0, *per_rock.values()] if all(np.isnan(list(per_rock.values()))) else list(per_rock.values())))  # fmt: skip
        bias = float(np.mean(np.abs(np.subtract(values, [f.value for f in mine]))))
        if (round(agreement, 3), -bias) > best:
            best, chosen = (round(agreement, 3), -bias), model
    return chosen, best[0]


def fly_geometric(
    flights: Sequence[Flight], configs: dict[str, MissionConfig], metric: str, stand_in: StandIn
) -> tuple[list[float], list[float], float]:
    """Values, shares of the photogrammetric mission's views that were chosen too, median wall time (s)."""
    objective = Objective(metric)
    values, shared, walls = [], [], []
    for f in flights:
        result = run_geometric_mission(configs[f.configuration], f.rock, f.replicate, stand_in=stand_in)
        value = objective.measure(result.metrics)
        values.append(float("nan") if value is None else value)
        shared.append(len({t.chosen for t in result.trace} & set(f.chosen)) / max(1, len(f.chosen)))
        walls.append(result.costs["wall_s"])
    return values, shared, float(np.median(walls))


def report(
    flights: Sequence[Flight],
    configs: dict[str, MissionConfig],
    metric: str,
    calibrated: Sequence[str],
    others: Sequence[str],
    do_fit: bool,
) -> str:
    """The Markdown report."""
    variants = {"constants in the code": StandIn()}
    lines = [
        "# Geometric against photogrammetric missions", "",
        f"`benchmarks/geometric_calibration.py`: {len(configs)} configurations, {len(flights)} photogrammetric missions,"
        f" metric `{metric}`. Spearman's rank correlation over configurations.", "",
    ]  # fmt: skip
    if do_fit:
        model, agreement = fit(flights, configs, metric, calibrated)
        variants["constants fitted here"] = StandIn(dense=model)
        lines += [
            f"Fitted on {', '.join(calibrated)} (mean rank correlation of the replayed views {agreement:.3f}):", "",
            "```", *(f"{name} = {value:g}" for name, value in asdict(model).items()), "```", "",
        ]  # fmt: skip
    for title, stand_in in variants.items():
        flown, shared, wall_s = fly_geometric(flights, configs, metric, stand_in)
        replayed = replay(flights, configs, metric, stand_in)
        lines += [
            f"## {title[0].upper()}{title[1:]}", "",
            f"Median wall time of a geometric mission: {1e3 * wall_s:.0f} ms.", "",
            "| rock | group | missions | end to end | same views, predicted only | views in common | spread measured / predicted (sd) | bias |",
            "|---|---|---|---|---|---|---|---|",
        ]  # fmt: skip
        for group, rocks in (("calibration", calibrated), ("other", others)):
            if not rocks:
                continue
            rows, mean = rock_and_mean_correlations(flights, flown, rocks)
            replay_rows, replay_mean = rock_and_mean_correlations(flights, replayed, rocks)
            for rock in rocks:
                mine = [i for i, f in enumerate(flights) if f.rock == rock]
                if not mine:
                    continue
                truth, guess = np.array([flights[i].value for i in mine]), np.array([flown[i] for i in mine])
                lines.append(
                    f"| {rock} | {group} | {len(mine)} | {rows[rock]:.2f} | {replay_rows[rock]:.2f} |"
                    f" {100 * np.mean([shared[i] for i in mine]):.0f} % | {truth.std():.2f} / {guess.std():.2f} |"
                    f" {np.mean(guess - truth):+.2f} |"
                )
            lines.append(f"| **mean over rocks** | {group} | | **{mean:.2f}** | {replay_mean:.2f} | | | |")
        lines.append("")
    return "\n".join(lines)


def tell(event: EvaluationEvent) -> None:
    """A line per mission."""
    if event.kind in ("finished", "failed") and event.job is not None:
        print(
            f"{event.finished} of {event.total} after {event.elapsed_s:.0f} s: {event.job.id} {event.kind}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directory", type=Path, help="where the photogrammetric missions are kept")
    parser.add_argument("--configurations", type=int, default=40)
    parser.add_argument(
        "--rocks", nargs="+", default=["boulder", "waist", "vesicular"], help="to calibrate on"
    )
    parser.add_argument("--others", nargs="*", default=["slab", "breccia", "cavern"], help="only to check on")
    parser.add_argument("--replicates", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1, help="0: fly in this process")
    parser.add_argument("--metric", default="observable.f_score_48mm")
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="laid over the preset"
    )
    parser.add_argument("--no-fit", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("docs/results/geometric_calibration.md"))
    arguments = parser.parse_args()
    import yaml

    overrides = {
        path: yaml.safe_load(value) for path, _, value in (item.partition("=") for item in arguments.set)
    }
    configs = configurations(arguments.configurations, preset("campaign").with_values(overrides))
    plan = EvaluationPlan(configs, (*arguments.rocks, *arguments.others), arguments.replicates)
    executor: Executor = InProcessExecutor() if arguments.workers == 0 else LocalProcessExecutor(arguments.workers)  # fmt: skip
    try:
        run = run_evaluation(plan, arguments.directory, executor, on_event=tell)
    finally:
        executor.close()
    if not run.complete:
        raise SystemExit(
            f"interrupted; start again with the same arguments to go on ({run.failures or 'no failures'})"
        )
    with threadpool_limits(1):
        text = report(
            collect(plan, arguments.directory, arguments.metric), configs, arguments.metric,
            arguments.rocks, arguments.others, not arguments.no_fit,
        )  # fmt: skip
    print(text)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(arguments.out, text)


if __name__ == "__main__":
    main()
