"""Can the oracle's choices be learned, and what does the learned gate gain in flight?

    OMP_NUM_THREADS=1 python -m research.learned_gate learn runs/noise-08 runs/noise-full
    OMP_NUM_THREADS=1 python -m research.learned_gate fly runs/noise-08 runs/noise-full --out runs/learned-gate \
        --rock slab --rock vesicular --rock cavern --rock ../shared/rocks/apollo_15016_0/apollo_15016_0.obj
    python -m research.learned_gate tables --out runs/learned-gate

``learn`` prints, for all logged decisions and for those made at the paper's weights: how often the oracle has
a preference at all, and how trees of several depths and a random forest (a ceiling: nobody could read it)
fare on rocks left out of the training, and on decisions of known rocks (random split: it measures how much a
model can cached about a rock, not what it would do on another).

``run_missions`` trains a policy per rock from the missions on the *other* rocks, then flies it on that rock against the
fixed scorers and the paper's gates, all with the same replicates. Preset ``campaign`` with 6 agreeing views.
Finished missions are not flown again. ``tables`` prints which scorer flew, and Table I's layout with paired
differences.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig, preset
from nbv.mission.result import MissionResult
from nbv.rocks import load_rock
from research.flown_missions import FlownMission, find_missions
from research.gate_learning import (
    GateDecisions,
    describe_tree,
    gate_decisions,
    learn_gate,
    without_rocks,
)
from tuner.evaluation.baselines import baseline_configs
from tuner.evaluation.comparison import comparison_table
from tuner.evaluation.plan import EvaluationPlan
from tuner.evaluation.run import run_evaluation
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.job import Trial
from tuner.report.comparison import table_i

STRATEGIES = ("covis", "b-aware", "hyb-h", "hyb-o", "learned")
REFERENCE = "covis"
AGREEING_VIEWS = 6
DEPTHS = (1, 2, 3, 4, 6)


def at_paper_weights(mission: FlownMission) -> bool:
    """Whether both scorers are the preset's, so that labels are the paper's."""
    base, config = MissionConfig(), mission.config
    return (config.covis, config.b_aware, config.shared) == (base.covis, base.b_aware, base.shared)


def gain_share(decisions: GateDecisions, chosen: np.ndarray) -> float:
    """Of what the oracle gains over always flying Covis."""
    margin = decisions.margin
    return float((margin * chosen).sum() / np.maximum(margin, 0).sum())


def describe(name: str, decisions: GateDecisions) -> None:
    """What was logged, and what models make of it."""
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.model_selection import LeaveOneGroupOut, StratifiedKFold
    from sklearn.tree import DecisionTreeClassifier

    counts, total = decisions.counts, len(decisions.rewards)
    print(
        f"\n### {name}: {decisions.missions} missions, {total} decisions on {len(set(decisions.rocks))} rocks\n"
    )
    print(
        f"- both scorers choose the same view in {decisions.same_view} ({100 * decisions.same_view / total:.0f} %); "
        f"the oracle prefers Covis' in {counts['covis']}, B-aware's in {counts['b-aware']}, neither in {counts['tie']}"
    )
    mean = decisions.rewards.mean(axis=0)
    print(
        f"- newly covered samples per decision: Covis {mean[0]:.0f}, B-aware {mean[1]:.0f}, the better of the two "
        f"{decisions.rewards.max(axis=1).mean():.0f}\n"
    )
    mask = decisions.informative
    x, y, weight = decisions.features[mask], decisions.labels[mask], np.abs(decisions.margin[mask])
    groups = np.array(decisions.rocks)[mask]
    models = {
        f"tree, depth {d}": DecisionTreeClassifier(
            max_depth=d, min_samples_leaf=max(5, len(y) // 20), random_state=0
        )
        for d in DEPTHS
    }
    models["random forest, 300 trees"] = RandomForestClassifier(300, min_samples_leaf=5, random_state=0)
    splits = {
        "unseen rocks": list(LeaveOneGroupOut().split(x, y, groups)),
        "known rocks": list(StratifiedKFold(5, shuffle=True, random_state=0).split(x, y)),
    }
    print(
        "| model | agrees with the oracle, unseen rocks | share of the oracle's gain over Covis | agrees, known rocks "
        "| share of the gain |\n|---|---:|---:|---:|---:|"
    )
    informative = GateDecisions(x, decisions.rewards[mask], tuple(groups), 0, 0, 0, 0, decisions.coverage)
    for label, model in models.items():
        cells = []
        for folds in splits.values():
            chosen = np.zeros(len(y), dtype=np.int64)
            for train, test in folds:
                chosen[test] = model.fit(x[train], y[train], sample_weight=weight[train]).predict(x[test])
            cells += [f"{100 * (chosen == y).mean():.0f} %", f"{100 * gain_share(informative, chosen):.0f} %"]
        print(f"| {label} | " + " | ".join(cells) + " |")
    for label, choice in (("always Covis", 0), ("always B-aware", 1)):
        share = gain_share(informative, np.full(len(y), choice))
        cells = [f"{100 * (y == choice).mean():.0f} %", f"{100 * share:.0f} %"] * 2
        print(f"| {label} | " + " | ".join(cells) + " |")


def plan_of(rock: str, replicate: int, policy: Path) -> EvaluationPlan:
    """All strategies on one rock with one replicate; the learned gate flies ``policy``."""
    base = preset("campaign").with_values({"dense.agreeing_views": AGREEING_VIEWS})
    configs = baseline_configs(STRATEGIES, base)
    configs["learned"] = configs["learned"].with_values({"gate.learned_policy": str(policy)})
    path = str(Path(rock).resolve()) if Path(rock).is_file() else rock
    return EvaluationPlan(configs, (path,), 1, first_replicate=replicate)


def run_missions(
    missions: Sequence[FlownMission], rocks: Sequence[str], replicates: Sequence[int], out: Path, workers: int
) -> None:
    """Leave-one-rock-out policies against the other gates."""
    for rock in rocks:
        name = load_rock(rock, Store()).name
        file = (out / "policies" / f"without-{name}.json").resolve()
        if not file.exists():  # a resumed study keeps the policy that it began with
            policy = learn_gate(gate_decisions(without_rocks(missions, [name])))
            policy.save(file)
            print(f"policy without {name}:", *describe_tree(policy.root), sep="\n    ")
        for replicate in replicates:
            with LocalProcessExecutor(workers) as executor:
                run_evaluation(plan_of(rock, replicate, file), out / f"{name}_r{replicate}", executor)


def tables(out: Path) -> None:
    """What has been flown so far."""
    records: list[Trial] = []
    for directory in sorted(path.parent for path in out.glob("*/evaluation.yaml")):
        records += EvaluationPlan.load(directory).records(directory)
    print("| rock | replicate | " + " | ".join(f"captures by B-aware, {s}" for s in STRATEGIES) + " |")
    print("|---|---:|" + "---:|" * len(STRATEGIES))
    for rock, replicate in sorted({(r.rock, r.replicate) for r in records}):
        evaluated = {r.strategy: r for r in records if (r.rock, r.replicate) == (rock, replicate)}
        cells = []
        for strategy in STRATEGIES:
            result = MissionResult.load(Path(evaluated[strategy].directory))
            cells.append(f"{sum(t.scorer == 'b-aware' for t in result.trace)} of {len(result.trace)}")
        print(f"| {Path(rock).stem} | {replicate} | " + " | ".join(cells) + " |")
    for surface in ("observable", "whole"):
        table = comparison_table(records, STRATEGIES, REFERENCE, surface)  # type: ignore[arg-type]
        print(f"\n{surface.capitalize()} surface\n\n{table_i(table, '').markdown()}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("learn", "fly", "tables"))
    parser.add_argument("runs", nargs="*", type=Path, help="directories of missions to learn from")
    parser.add_argument("--rock", action="append", default=[], help="fly: training rock, repeatable")
    parser.add_argument("--replicate", type=int, action="append", help="fly: repeatable (default: 0 and 1)")
    parser.add_argument("--out", type=Path, default=Path("runs/learned-gate"))
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.what == "tables":
        tables(arguments.out)
        return
    missions = find_missions(arguments.runs)
    if arguments.what == "learn":
        describe("All missions", gate_decisions(missions))
        describe("At the paper's weights", gate_decisions([m for m in missions if at_paper_weights(m)]))
    else:
        run_missions(
            missions, arguments.rock, arguments.replicate or [0, 1], arguments.out, arguments.workers
        )


if __name__ == "__main__":
    main()
