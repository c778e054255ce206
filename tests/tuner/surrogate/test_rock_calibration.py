"""Leave-one-rock-out: on rocks that share a landscape, and on one that has its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import synthetic

from tuner.problem.observations import Observation
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.rock_calibration import MIN_MISSIONS, leave_one_rock_out


def build(history, rocks):
    return RockMeanGP(synthetic.SPACE, history, rocks, 0)


def test_rocks_of_one_kind_are_predicted_and_calibrated() -> None:
    history = synthetic.random_design(64, 0.1, 3)
    checks = leave_one_rock_out(history, synthetic.ROCKS, build)
    assert [c.rock for c in checks] == list(synthetic.ROCKS)
    assert sum(c.missions for c in checks) == 64
    assert np.mean([c.spearman for c in checks]) > 0.6
    assert np.mean([c.inside_95 for c in checks]) > 0.8


def test_a_rock_of_another_kind_is_found_out() -> None:
    history = synthetic.random_design(64, 0.05, 3)
    mean = np.mean([o.outcome for o in history if o.rock == "r1"])
    opposed = [dataclasses.replace(o, outcome=2 * mean - o.outcome) if o.rock == "r1" else o for o in history]
    by_rock = {c.rock: c for c in leave_one_rock_out(opposed, synthetic.ROCKS, build)}
    assert by_rock["r1"].spearman < -0.5 < 0.2 < by_rock["r0"].spearman
    assert by_rock["r1"].inside_95 < by_rock["r0"].inside_95


def test_nothing_to_check() -> None:
    history = synthetic.random_design(12, 0.1, 0)
    one = [o for o in history if o.rock == "r0"]
    assert leave_one_rock_out(one, synthetic.ROCKS, build) == []
    few = [*history, *(dataclasses.replace(o, rock="new") for o in history[: MIN_MISSIONS - 1])]
    assert "new" not in [c.rock for c in leave_one_rock_out(few, (*synthetic.ROCKS, "new"), build)]
    failed = [Observation(i, o.values, "r9", 0, None, None) for i, o in enumerate(history)]
    assert "r9" not in [
        c.rock for c in leave_one_rock_out([*history, *failed], (*synthetic.ROCKS, "r9"), build)
    ]
