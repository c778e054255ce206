"""The learned gate: labels, training, honesty, and the round trip into ``nbv.gates.learned``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.gates import learned as learned_module
from nbv.gates.features import FEATURE_NAMES
from nbv.gates.learned import LearnedGate
from nbv.mission.result import IterationRecord, MissionResult
from nbv.types import Ranking
from research.flown_missions import find_missions
from research.gate_learning import (
    SCORERS,
    GateDecisions,
    describe_tree,
    gate_decisions,
    judged_by,
    learn_gate,
    score_choices,
    without_rocks,
)

D95 = FEATURE_NAMES.index("d95_m")


def decisions(rule, n=240, rocks=4, seed=0) -> GateDecisions:
    """Random features; ``rule(features, rng)`` gives (n, 2) rewards."""
    rng = np.random.default_rng(seed)
    features = rng.random((n, len(FEATURE_NAMES)))
    return GateDecisions(
        features,
        rule(features, rng),
        tuple(f"rock{i % rocks}" for i in range(n)),
        rocks,
        0,
        0,
        0,
        "matchable",
    )


def threshold_rule(features, rng):
    """B-aware is worth 10 to 20 more where d95 is above 0.6, Covis as much elsewhere; some ties."""
    gain = 10 + 10 * rng.random(len(features))
    coarse = features[:, D95] > 0.6
    rewards = np.stack([np.where(coarse, 0.0, gain), np.where(coarse, gain, 0.0)], axis=1)
    rewards[::7] = 5.0
    return rewards


def test_a_threshold_is_learned_and_readable():
    policy = learn_gate(decisions(threshold_rule))
    assert policy.root["feature"] == "d95_m" and policy.root["threshold"] == pytest.approx(0.6, abs=0.03)
    assert policy.root["left"]["scorer"] == "covis" and policy.root["right"]["scorer"] == "b-aware"
    assert policy.root["left"]["probability"] == policy.root["right"]["probability"] == 1.0
    scores = {score.name: score for score in policy.scores}
    assert scores["tree"].accuracy > 0.95 and scores["tree"].regret < 1.0 and scores["tree"].gain_share > 0.9
    assert scores["majority"].accuracy < 0.7 and scores["majority"].regret > 3.0
    assert scores["logistic"].accuracy > scores["majority"].accuracy
    assert scores["always covis"].gain_share == 0.0
    assert policy.notes == []
    assert describe_tree(policy.root)[0].startswith("if d95_m <= 0.")


def test_what_is_exported_decides_as_scikit_learn_does(tmp_path, monkeypatch):
    """A deep tree on noisy labels, walked by the gate for fresh features."""

    def noisy(features, rng):
        score = (
            features[:, 0] + features[:, D95] * features[:, 7] - 0.8 + 0.3 * rng.normal(size=len(features))
        )
        return np.stack([np.maximum(-score, 0), np.maximum(score, 0)], axis=1)

    policy = learn_gate(decisions(noisy, n=600), max_depth=6)
    assert len(describe_tree(policy.root)) > 10
    policy.save(tmp_path / "policy.json")
    gate = LearnedGate(MissionConfig().with_values({"gate.learned_policy": str(tmp_path / "policy.json")}))
    empty = np.zeros(0)
    both = {name: Ranking(name, empty.astype(int), empty, {}) for name in SCORERS}
    fresh = np.concatenate(
        [np.random.default_rng(9).random((400, len(FEATURE_NAMES))), policy.decisions.features]
    )
    expected = policy.tree.predict(fresh)
    for row, scorer in zip(fresh, expected):
        values = dict(zip(FEATURE_NAMES, map(float, row)))
        monkeypatch.setattr(learned_module, "gate_features", lambda state, config, values=values: values)
        assert gate.decide(None, None, both).ranking.scorer == SCORERS[scorer]  # type: ignore[arg-type]


def test_large_rewards_outweigh_many_small_ones():
    """Two decisions of a hundred samples against twenty of one, indistinguishable by their features."""

    def rule(features, rng):
        features[:] = 0.5
        rewards = np.zeros((len(features), 2))
        rewards[:, 0] = 1.0
        rewards[:2] = [0.0, 100.0]
        return rewards

    assert learn_gate(decisions(rule, n=22, rocks=2)).root["scorer"] == "b-aware"


def test_one_class_is_said():
    def rule(features, rng):
        return np.stack([rng.random(len(features)), np.zeros(len(features))], axis=1)

    policy = learn_gate(decisions(rule))
    assert policy.root == {"scorer": "covis", "probability": 1.0, "samples": 240}
    assert "one-class" in policy.notes[0] and "b-aware is never preferred" in policy.notes[0]
    assert {score.name: score.regret for score in policy.scores}["tree"] == 0.0


def test_ties_everywhere_leave_nothing_to_learn():
    with pytest.raises(UserError, match="indifferent in all 240"):
        learn_gate(decisions(lambda features, rng: np.ones((len(features), 2))))


def test_a_rule_that_does_not_carry_over_is_admitted():
    """What is right on a rock is wrong on the others: cross-validation by rock must notice."""

    def rule(features, rng):
        rock = np.arange(len(features)) % 4
        features[:, 3] = rock + 0.01 * rng.random(len(features))  # tells the rocks apart
        b_aware = rock % 2 == 0
        return np.stack([~b_aware, b_aware], axis=1).astype(float)

    policy = learn_gate(decisions(rule))
    assert policy.tree.score(policy.decisions.features, policy.decisions.labels) == 1.0
    assert {score.name: score.accuracy for score in policy.scores}["tree"] < 0.8
    assert any("unseen rocks" in note for note in policy.notes)


def test_one_rock_is_not_cross_validated():
    policy = learn_gate(decisions(threshold_rule, rocks=1))
    assert policy.scores == [] and any("one rock only" in note for note in policy.notes)


def test_regret_counts_ties_as_nothing_lost():
    d = decisions(lambda features, rng: np.array([[3.0, 1.0], [0.0, 4.0], [2.0, 2.0], [5.0, 6.0]]), n=4)
    covis = score_choices("covis", d, np.zeros(4, dtype=int))
    assert (covis.accuracy, covis.regret, covis.gain_share) == (pytest.approx(1 / 3), (4 + 1) / 4, 0.0)
    assert score_choices("oracle", d, d.labels).regret == 0.0
    assert score_choices("oracle", d, d.labels).gain_share == 1.0


# -- from missions' logs -------------------------------------------------------------------------------------


def record(iteration, covis, b_aware, tops=("cand_001", "cand_002"), **changes):
    features = {name: 0.1 * i + iteration for i, name in enumerate(FEATURE_NAMES)}
    return IterationRecord(
        iteration,
        100,
        {},
        0.1,
        1000,
        24,
        0.003,
        "covis",
        "",
        {},
        {"covis": covis, "b-aware": b_aware},
        {**features, **changes},
        {name: {"candidate": top} for name, top in zip(SCORERS, tops)},
        "cand_001",
        True,
        "",
        1.0,
        1.0,
        0.1,
        0.1,
    )


def write_mission(directory: Path, rock: str, trace, replicate=0, **values):
    config = MissionConfig().with_values(values)
    directory.mkdir(parents=True)
    (directory / "config.yaml").write_text(yaml.safe_dump(config.to_dict()))
    result = MissionResult("ok", "", "", config.digest(), rock, replicate, {}, trace, {}, {})
    (directory / "mission.json").write_text(result.to_json())


def test_decisions_are_read_from_the_traces(tmp_path):
    write_mission(
        tmp_path / "a",
        "r0",
        [record(0, 3.0, 5.0), record(1, 4.0, 4.0, ("cand_007",) * 2), record(2, 9.0, 1.0)],
    )
    write_mission(tmp_path / "b", "r0", [record(0, 3.0, 5.0), record(1, 0.0, 1.0, d95_m=float("inf"))])
    write_mission(tmp_path / "c", "r1", [record(0, 3.0, 5.0)])
    found = gate_decisions(find_missions([tmp_path]))
    assert found.counts == {"covis": 1, "b-aware": 2, "tie": 1}
    assert (found.missions, found.duplicates, found.incomplete, found.same_view) == (3, 1, 1, 1)
    assert sorted(found.rocks) == ["r0", "r0", "r0", "r1"]
    assert found.margin.tolist() == [2.0, 0.0, -8.0, 2.0]
    write_mission(tmp_path / "d", "r1", [record(0, 3.0, 5.0)], **{"gate.oracle_coverage": "seen"})
    with pytest.raises(UserError, match=r"different oracles.*seen.*--oracle"):
        gate_decisions(find_missions([tmp_path]))
    assert gate_decisions(judged_by(find_missions([tmp_path]), "reconstruction")).counts == found.counts
    assert gate_decisions(judged_by(find_missions([tmp_path]), "seen")).missions == 1
    with pytest.raises(UserError, match="no mission was judged by the oracle 'best'; there are"):
        judged_by(find_missions([tmp_path]), "best")


def test_held_out_rocks_are_refused_by_name(tmp_path):
    write_mission(tmp_path / "a", "slab", [record(0, 3.0, 5.0)])
    write_mission(tmp_path / "b", "arch", [record(0, 9.0, 5.0)])
    missions = find_missions([tmp_path])
    with pytest.raises(UserError, match=r"b was flown on 'arch', which is held out.*--without arch"):
        gate_decisions(missions)
    assert set(gate_decisions(without_rocks(missions, ["arch"])).rocks) == {"slab"}
    with pytest.raises(UserError, match=r"no mission was flown on 'arc'; there are arch, slab"):
        without_rocks(missions, ["arc"])


def test_an_imported_held_out_rock_is_refused_too(tmp_path, monkeypatch):
    from nbv.rocks import load_rock, save_imported
    from nbv.rocks.rock import make_rock

    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    rock = make_rock("mine", vertices, faces, np.full((4, 3), 0.5), split="held-out", difficulty="")
    save_imported(rock)
    assert load_rock("mine").split == "held-out"
    write_mission(tmp_path / "a", "mine", [record(0, 3.0, 5.0)])
    with pytest.raises(UserError, match="'mine', which is held out"):
        gate_decisions(find_missions([tmp_path / "a"]))


def test_missions_without_logs_are_a_users_mistake(tmp_path):
    write_mission(tmp_path / "a", "r0", [])
    with pytest.raises(UserError, match="no mission logged"):
        gate_decisions(find_missions([tmp_path]))


def test_the_policy_file_says_what_it_was_trained_on(tmp_path):
    policy = learn_gate(decisions(threshold_rule))
    policy.save(tmp_path / "sub" / "policy.json")
    tree = json.loads((tmp_path / "sub" / "policy.json").read_text())
    assert tree["trained_on"]["rocks"] == ["rock0", "rock1", "rock2", "rock3"]
    assert tree["trained_on"]["oracle_prefers"] == policy.decisions.counts
    assert tree["cross_validated_by_rock"][0]["name"] == "tree"
