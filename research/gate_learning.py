"""The learned gate: from what an oracle thought of both scorers' choices to a small readable tree.

Missions of `research.with_oracle` log, at every iteration and whatever they flew, what a ground-truth oracle
would have gained from each scorer's best candidate (``oracle_rewards``) and what a deployable gate may look at (``features``). A
decision is labelled B-aware where B-aware's reward is strictly larger, Covis where Covis' is; ties say nothing
and are left out. The difference of the rewards is the sample's weight. Features do not depend on the scorers'
weights; the labels do, so a policy is an answer for configurations like those it was learned from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import LeaveOneGroupOut
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.tree import DecisionTreeClassifier

from nbv.errors import UserError
from nbv.gates.features import FEATURE_NAMES
from nbv.gates.learned import check_policy
from nbv.mission.run_directory import write_atomic
from nbv.rocks import list_rocks
from nbv.safe_files import parse_json
from nbv.scorers import PAPER_SCORERS
from nbv.types import Floats, Ints
from research.flown_missions import FlownMission

SCORERS = PAPER_SCORERS  # class 0, Covis, and class 1, B-aware: an exact draw of the votes goes to Covis
MAX_DEPTH = 3
MIN_LEAF_SHARE, MIN_LEAF = 0.05, 5  # of the training samples; at least so many


@dataclass(frozen=True)
class GateDecisions:
    """Logged decisions, ties included."""

    features: Floats  # (n, f), columns as in ``FEATURE_NAMES``
    rewards: Floats  # (n, 2), columns as in ``SCORERS``: newly covered samples
    rocks: tuple[str, ...]  # (n,)
    missions: int
    duplicates: int  # the same decision, met by several missions, counts once
    incomplete: int  # without rewards or with a feature that is not finite
    same_view: int  # decisions in which both scorers choose the same candidate (all of them ties)
    coverage: str  # which oracle: ``gate.oracle_coverage``
    presets: tuple[str, ...] = ()  # of the missions; features mean something else at other settings
    adaptive_budgets: tuple[int, ...] = ()

    @property
    def margin(self) -> Floats:
        """(n,) B-aware's reward minus Covis'."""
        result: Floats = self.rewards[:, 1] - self.rewards[:, 0]
        return result

    @property
    def informative(self) -> np.ndarray:
        """(n,) decisions that are no ties."""
        return self.margin != 0

    @property
    def labels(self) -> Ints:
        """(n,) index into ``SCORERS`` of what the oracle prefers; ties are Covis, as for Hyb-O."""
        return (self.margin > 0).astype(np.int64)

    @property
    def counts(self) -> dict[str, int]:
        """Decisions by what the oracle prefers."""
        kinds = {SCORERS[0]: self.margin < 0, SCORERS[1]: self.margin > 0, "tie": self.margin == 0}
        return {name: int(mask.sum()) for name, mask in kinds.items()}

    def select(self, mask: np.ndarray) -> tuple[Floats, Ints, Floats]:
        """``(features, labels, weights)`` of some decisions; the weights' mean is 1."""
        weight = np.abs(self.margin[mask])
        return self.features[mask], self.labels[mask], weight / weight.mean()


def held_out_rocks() -> set[str]:
    """Names of all rocks that nothing may be learned from, imported ones included."""
    return {rock.name for rock in list_rocks() if rock.split == "held-out"}


def without_rocks(missions: Sequence[FlownMission], rocks: Collection[str]) -> list[FlownMission]:
    """The missions on other rocks; ``UserError`` if a name is none of theirs."""
    evaluated = {m.result.rock for m in missions}
    for rock in rocks:
        if rock not in evaluated:
            raise UserError(f"no mission was flown on {rock!r}; there are {', '.join(sorted(evaluated))}")
    return [m for m in missions if m.result.rock not in rocks]


def judged_by(missions: Sequence[FlownMission], coverage: str) -> list[FlownMission]:
    """The missions whose rewards come from one oracle; ``UserError`` if there is none."""
    kept = [m for m in missions if m.config.gate.oracle_coverage == coverage]
    if not kept:
        found = ", ".join(sorted({m.config.gate.oracle_coverage for m in missions}))
        raise UserError(f"no mission was judged by the oracle {coverage!r}; there are {found}")
    return kept


def gate_decisions(missions: Sequence[FlownMission]) -> GateDecisions:
    """All decisions that missions logged.

    Raises
    ------
    UserError
        A mission was flown on a held-out rock, the missions were judged by different oracles, or none logged
        anything.
    """
    forbidden = held_out_rocks()
    for mission in missions:
        if mission.result.rock in forbidden:
            raise UserError(
                f"{mission.directory} was flown on {mission.result.rock!r}, which is held out: nothing may be "
                f"learned from it; leave it out, for example with --without {mission.result.rock}"
            )
    kinds = sorted({m.config.gate.oracle_coverage for m in missions})
    if len(kinds) > 1:
        raise UserError(
            f"the missions log rewards of different oracles (gate.oracle_coverage: {', '.join(kinds)}); "
            "learn from missions of one, chosen with --oracle"
        )
    rows: dict[tuple[Any, ...], tuple[list[float], list[float], str]] = {}
    duplicates = incomplete = same_view = 0
    for mission in missions:
        for record in mission.result.trace:
            features = [record.features.get(name) for name in FEATURE_NAMES]
            rewards = [record.oracle_rewards.get(name) for name in SCORERS]
            if not all(_finite(value) for value in [*features, *rewards]):
                incomplete += 1
                continue
            key = (mission.result.rock, mission.result.replicate, record.iteration, *features, *rewards)
            if key in rows:
                duplicates += 1
                continue
            same_view += len({record.top.get(name, {}).get("candidate", name) for name in SCORERS}) == 1
            rows[key] = (features, rewards, mission.result.rock)  # type: ignore[assignment]
    if not rows:
        raise UserError(
            "no mission logged what an oracle would have gained from both scorers; fly missions with "
            "--fidelity research.with_oracle:photogrammetric or research.with_oracle:geometric"
        )
    features_, rewards_, rocks = zip(*rows.values())
    return GateDecisions(
        np.array(features_, dtype=float),
        np.array(rewards_, dtype=float),
        tuple(rocks),
        len(missions),
        duplicates,
        incomplete,
        same_view,
        kinds[0],
        tuple(sorted({m.config.preset for m in missions})),
        tuple(sorted({m.config.stop.adaptive_budget for m in missions})),
    )


def _finite(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True)
class PolicyScore:
    """How a way of choosing fares on decisions it has not seen (or, for fixed choices, on all)."""

    name: str
    accuracy: float | None  # share of informative decisions on which it agrees with the oracle
    regret: float  # mean samples lost per decision against the oracle's choice, ties included
    gain_share: (
        float | None
    )  # share of what the oracle gains over always flying Covis; None: it gains nothing


@dataclass(frozen=True)
class LearnedPolicy:
    """A trained policy and what is known about it."""

    tree: Any  # fitted DecisionTreeClassifier, or None when the labels are of one class
    root: dict[str, Any]  # the same as nested nodes, see ``nbv.gates.learned``
    decisions: GateDecisions
    scores: list[PolicyScore]  # cross-validated by rock; empty with a single rock
    notes: list[str]  # what a reader must know before using it

    def to_dict(self) -> dict[str, Any]:
        """The policy file's content."""
        d = self.decisions
        return {
            "type": "decision_tree",
            "version": 1,
            "root": self.root,
            "trained_on": {
                "missions": d.missions,
                "rocks": sorted(set(d.rocks)),
                "decisions": len(d.rewards),
                "oracle_prefers": d.counts,
                "same_view": d.same_view,
                "oracle_coverage": d.coverage,
                "presets": list(d.presets),
                "adaptive_budgets": list(d.adaptive_budgets),
            },
            "cross_validated_by_rock": [vars(score) for score in self.scores],
            "notes": self.notes,
        }

    def save(self, path: Path) -> None:
        """Write the policy file; ``UserError`` if that is not possible."""
        text = json.dumps(self.to_dict(), indent=1)
        check_policy(parse_json(text, str(path)), str(path))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, text + "\n")
        except OSError as error:
            raise UserError(f"cannot write {path}: {error.strerror}; choose another --out") from error


def learn_gate(decisions: GateDecisions, max_depth: int = MAX_DEPTH, seed: int = 0) -> LearnedPolicy:
    """Train on all decisions, and cross-validate by rock.

    Raises
    ------
    UserError
        Every decision is a tie, or ``max_depth`` is below 1.
    """
    if max_depth < 1:
        raise UserError(f"the tree's depth is {max_depth}; give at least 1")
    counts, notes = decisions.counts, []
    informative = decisions.informative
    if not informative.any():
        raise UserError(
            f"nothing to learn: the oracle ({decisions.coverage}) is indifferent in all {len(decisions.rewards)} "
            "decisions; fly missions with another gate.oracle_coverage, for example matchable"
        )
    if min(counts[name] for name in SCORERS) == 0:
        only, other = sorted(SCORERS, key=lambda name: -counts[name])
        notes.append(
            f"one-class labels: wherever the oracle is not indifferent it prefers {only}; there is nothing to "
            f"switch on, and the policy is to fly {only} always. {other} is never preferred in these missions"
        )
        leaf = {"scorer": only, "probability": 1.0, "samples": int(informative.sum())}
        return LearnedPolicy(None, leaf, decisions, _cross_validate(decisions, max_depth, seed), notes)
    tree = _fit_tree(*decisions.select(informative), max_depth, seed)
    scores = _cross_validate(decisions, max_depth, seed)
    if len(set(decisions.rocks)) < 2:
        notes.append("one rock only: not cross-validated, nothing is known about other rocks")
    by_name = {score.name: score for score in scores}
    if scores:
        simple = min((s for s in scores if s.name not in ("tree", "logistic")), key=lambda s: s.regret)
        if by_name["tree"].regret >= simple.regret:
            notes.append(
                f"no better than a fixed choice: on unseen rocks the tree loses {by_name['tree'].regret:.1f} samples "
                f"per decision, {simple.name} {simple.regret:.1f}"
            )
    root = _export(tree, decisions.features[informative], decisions.labels[informative])
    return LearnedPolicy(tree, root, decisions, scores, notes)


def _fit_tree(features: Floats, labels: Ints, weights: Floats, max_depth: int, seed: int) -> Any:
    leaf = max(MIN_LEAF, math.ceil(MIN_LEAF_SHARE * len(labels)))
    tree = DecisionTreeClassifier(max_depth=max_depth, min_samples_leaf=leaf, random_state=seed)
    return tree.fit(features, labels, sample_weight=weights)


def _fit_logistic(features: Floats, labels: Ints, weights: Floats) -> Any:
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
    return model.fit(features, labels, logisticregression__sample_weight=weights)


def _cross_validate(decisions: GateDecisions, max_depth: int, seed: int) -> list[PolicyScore]:
    """Every rock in turn is left out of the training; fixed choices beside the learned ones."""
    n, groups = len(decisions.rewards), np.array(decisions.rocks)
    if len(set(decisions.rocks)) < 2:
        return []
    chosen = {name: np.zeros(n, dtype=np.int64) for name in ("tree", "logistic", "majority")}
    for train, test in LeaveOneGroupOut().split(decisions.features, groups=groups):
        mask = np.zeros(n, dtype=bool)
        mask[train] = True
        mask &= decisions.informative
        if not mask.any():
            continue  # nothing known: Covis, as for a tie
        features, labels, weights = decisions.select(mask)
        majority = int(weights[labels == 1].sum() > weights[labels == 0].sum())
        chosen["majority"][test] = majority
        if len(np.unique(labels)) == 1:
            chosen["tree"][test] = chosen["logistic"][test] = labels[0]
            continue
        held_out = decisions.features[test]
        chosen["tree"][test] = _fit_tree(features, labels, weights, max_depth, seed).predict(held_out)
        chosen["logistic"][test] = _fit_logistic(features, labels, weights).predict(held_out)
    fixed = {f"always {name}": np.full(n, i, dtype=np.int64) for i, name in enumerate(SCORERS)}
    return [score_choices(name, decisions, choice) for name, choice in {**chosen, **fixed}.items()]


def score_choices(name: str, decisions: GateDecisions, chosen: Ints) -> PolicyScore:
    """Accuracy and regret of (n,) choices of a scorer."""
    rewards, informative = decisions.rewards, decisions.informative
    got = rewards[np.arange(len(chosen)), chosen]
    best = rewards.max(axis=1)
    possible = float((best - rewards[:, 0]).sum())
    return PolicyScore(
        name,
        float((chosen == decisions.labels)[informative].mean()) if informative.any() else None,
        float((best - got).mean()),
        float((got - rewards[:, 0]).sum()) / possible if possible > 0 else None,
    )


def _export(tree: Any, features: Floats, labels: Ints) -> dict[str, Any]:
    """Nested nodes of a fitted tree; splits whose two sides agree are merged."""
    inner = tree.tree_
    leaf_of = tree.apply(features)
    scorer_of: Callable[[int], str] = lambda node: SCORERS[int(tree.classes_[inner.value[node, 0].argmax()])]  # noqa: E731

    def leaf(nodes: list[int]) -> dict[str, Any]:
        scorer = scorer_of(nodes[0])
        own = labels[np.isin(leaf_of, nodes)]
        agree = float((own == SCORERS.index(scorer)).mean())
        return {"scorer": scorer, "probability": agree, "samples": len(own)}

    def walk(node: int) -> tuple[dict[str, Any], list[int]]:
        left, right = int(inner.children_left[node]), int(inner.children_right[node])
        if left == right:  # scikit-learn's mark of a leaf
            return leaf([node]), [node]
        (low, low_nodes), (high, high_nodes) = walk(left), walk(right)
        if "scorer" in low and "scorer" in high and low["scorer"] == high["scorer"]:
            return leaf([*low_nodes, *high_nodes]), [*low_nodes, *high_nodes]
        name = FEATURE_NAMES[int(inner.feature[node])]
        branch = {"feature": name, "threshold": float(inner.threshold[node]), "left": low, "right": high}
        return branch, [*low_nodes, *high_nodes]

    return walk(0)[0]


def describe_tree(root: dict[str, Any], indent: str = "") -> list[str]:
    """The policy in words, one line per node."""
    if "scorer" in root:
        return [
            f"{indent}{root['scorer']} ({100 * root['probability']:.0f} % of {root['samples']} decisions)"
        ]
    test = f"{root['feature']} <= {root['threshold']:.4g}"
    return [
        f"{indent}if {test}:",
        *describe_tree(root["left"], indent + "    "),
        f"{indent}else:",
        *describe_tree(root["right"], indent + "    "),
    ]
