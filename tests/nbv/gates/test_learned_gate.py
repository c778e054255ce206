"""Features and the decision tree that reads them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from gate_states import pool, rankings, state

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.gates import Gate, gate_features, make_gate
from nbv.gates.features import FEATURE_NAMES
from nbv.gates.learned import policy_digest, shipped_policy
from nbv.rocks import list_rocks

TREE = {
    "type": "decision_tree",
    "version": 1,
    "root": {
        "feature": "f_b",
        "threshold": 0.5,
        "left": {"scorer": "b-aware", "probability": 0.9},
        "right": {
            "feature": "mean_track_length",
            "threshold": 3.0,
            "left": {"scorer": "b-aware", "probability": 0.6},
            "right": {"scorer": "covis", "probability": 0.8},
        },
    },
}


def gate_for(tmp_path: Path, policy: object) -> Gate:
    path = tmp_path / "policy.json"
    path.write_text(policy if isinstance(policy, str) else json.dumps(policy))
    config = MissionConfig().with_values({"gate.kind": "learned", "gate.learned_policy": str(path)})
    return make_gate(config)


def test_features_are_what_they_say() -> None:
    points = np.array([[0.0, 0, 0.8], [0.1, 0, 0.8], [0.3, 0, 0.8], [9.0, 9.0, 0.0]])
    s = state(points=points, used=4, lengths=np.array([2, 4, 9, 2]), d95_m=0.2)
    features = gate_features(s, MissionConfig())
    assert tuple(features) == FEATURE_NAMES
    assert features["f_b"] == 0.1 and features["d95_m"] == 0.2
    assert features["box_points"] == 3
    assert features["mean_track_length"] == 5 and features["median_track_length"] == 4
    assert features["fraction_weak_tracks"] == pytest.approx(2 / 3)
    assert features["fraction_two_view"] == pytest.approx(1 / 3)
    assert features["mean_spacing_m"] == pytest.approx(np.mean([0.2, 0.15, 0.25]))
    assert features["registered_fraction"] == 1.0 and features["n_visited"] == 24
    assert features["mean_reprojection_px"] == pytest.approx(s.model.reprojection_error_px[:3].mean())


def test_walks_the_tree(tmp_path: Path) -> None:
    gate = gate_for(tmp_path, TREE)
    both, candidates = rankings(0, 1, len(pool())), pool()
    early = gate.decide(state(used=20), candidates, both)  # f_b = 0.5: left, at most
    assert early.ranking is both["b-aware"] and early.details["probability"] == 0.9
    late = gate.decide(state(used=21, lengths=np.full(50, 5)), candidates, both)
    assert late.ranking is both["covis"] and "mean_track_length 5 > 3" in late.reason
    weak = gate.decide(state(used=21, lengths=np.full(50, 2)), candidates, both)
    assert weak.ranking is both["b-aware"] and weak.details["features"]["mean_track_length"] == 2


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("{", "not valid JSON"),
        ([], "decision_tree"),
        ({"type": "decision_tree", "version": 9}, "version 9"),
        ({"type": "decision_tree", "version": 1}, "root is missing"),
        (TREE | {"root": {"scorer": "best", "probability": 1}}, "names scorer 'best'"),
        (TREE | {"root": {"scorer": "covis", "probability": 7}}, "probability"),
        (TREE | {"root": {"feature": "luck", "threshold": 1}}, "feature 'luck'"),
        (TREE | {"root": {"feature": "f_b", "threshold": "a"}}, "threshold"),
        (TREE | {"root": {"feature": "f_b", "threshold": 1, "left": TREE["root"]}}, "root.right is missing"),
    ],
)
def test_bad_policies_are_a_users_mistake(tmp_path: Path, policy: object, message: str) -> None:
    with pytest.raises(UserError, match=message):
        gate_for(tmp_path, policy)


def test_without_a_file_the_shipped_policy_is_flown() -> None:
    gate = make_gate(MissionConfig().with_values({"gate.kind": "learned"}))
    both = rankings(0, 1, len(pool()))
    decision = gate.decide(state(), pool(), both)
    assert decision.ranking in (both["covis"], both["b-aware"])
    policy = shipped_policy()
    assert decision.details["policy"] == policy_digest(policy["root"])
    # It says where it comes from, and no rock that is held out is among its teachers.
    held_out = {rock.name for rock in list_rocks() if rock.split == "held-out"}
    trained = policy["trained_on"]
    assert trained["rocks"] and not held_out & set(trained["rocks"])
    assert sum(trained["oracle_prefers"].values()) == trained["decisions"] > 100
    scores = {score["name"]: score for score in policy["cross_validated_by_rock"]}
    assert {"tree", "majority", "always covis"} <= set(scores)


def test_a_missing_file_is_named() -> None:
    config = MissionConfig().with_values({"gate.kind": "learned", "gate.learned_policy": "no.json"})
    with pytest.raises(UserError, match=r"no\.json"):
        make_gate(config)
