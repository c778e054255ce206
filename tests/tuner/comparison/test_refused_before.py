from pathlib import Path
from typing import Any

import pytest
from in_process import InProcessExecutor

import tuner
from nbv.config import load_conditions, preset, under
from nbv.errors import UserError
from tuner.comparison.plan import EvaluationPlan, run_evaluation

HIGH = {"flight.min_camera_altitude_m": 1.6}  # above an orbit at 10°


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"space": "gate", "overrides": HIGH}, "strategy orbit cannot run"),
        ({"space": "plan_and_gate", "overrides": HIGH}, "strategy orbit cannot run"),
        ({"space": "gate", "overrides": {"photographs": 20}}, "seeds is 24, more than the 20 photographs"),
        ({"space": "gate", "compare_on": ["nowhere"]}, "unknown rock 'nowhere'"),
        ({"space": "gate", "fidelity": "photographs", "compare_on": []}, "cannot run on slab"),
    ],
)
def test_a_campaign_whose_comparison_cannot_run(tmp_path: Path, asked: dict[str, Any], named: str) -> None:
    settings = {"rocks": ["slab"], "compare_on": ["arch"], "fidelity": "geometric", "budget": 3, **asked}
    with pytest.raises(UserError, match=named):
        tuner.tune(tmp_path / "run", workers=1, **settings)
    assert not (tmp_path / "run").exists()


def test_an_evaluation_with_a_strategy_that_cannot_run(tmp_path: Path) -> None:
    indoors, harsh = load_conditions(["indoors", "harsh"])
    base = preset("campaign")
    strategies = {"hyb-h": base, "elsewhere": under(base, harsh)}
    plan = EvaluationPlan(strategies, ("slab",), fidelity="geometric", conditions=(indoors,))
    with pytest.raises(UserError, match="strategy elsewhere cannot run under indoors"):
        run_evaluation(plan, tmp_path / "out", InProcessExecutor())
    assert not (tmp_path / "out").exists()
