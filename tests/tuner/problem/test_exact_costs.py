"""What the configuration decides: where it does, what it is, and when a mission says otherwise."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import fake_campaigns
import pytest

from nbv.config import preset
from tuner.problem.exact_costs import Exact, ExactCost, exact_cost
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.space_files import load_search_space, space_from_dict

PHOTOGRAPHS = Objective("costs.images", "minimise")
SPACE = load_search_space("photographs")


def photographs(**base: Any) -> ExactCost | None:
    space = dataclasses.replace(
        SPACE, base={**SPACE.base, **{k.replace("__", "."): v for k, v in base.items()}}
    )
    asked = fake_campaigns.settings(space=space, objective=PHOTOGRAPHS, second=Objective(), limit=98.0)
    return asked.exact.first


def test_photographs_are_seeds_and_planned_views() -> None:
    found = photographs()
    assert found is not None and found.paths == ("seed.count", "stop.adaptive_budget")
    values = {"seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.5}
    assert found.of(values) == 26.0 and found.outcome(values) == -26.0
    assert found.of({**values, "seed.count": 20, "stop.adaptive_budget": 0}) == 20.0
    cut = photographs(stop__max_photographs=30)
    most = {**values, "seed.count": 24}
    assert cut is not None and cut.of(values) == 26.0 and cut.of(most) == 30.0


@pytest.mark.parametrize("base", [{"stop__criterion": "both"}, {"stop__min_gain_percent": 1.0}])
def test_what_a_mission_may_cut_short_is_not_known(base: dict[str, Any]) -> None:
    assert photographs(**base) is None


def test_flight_time_and_a_tuned_stopping_rule_are_not_known() -> None:
    rule = space_from_dict(
        {
            "name": "rule",
            "base": {"gate.kind": "hyb-h"},
            "parameters": {"stop.criterion": {"kind": "categorical", "choices": ["budget", "both"]}},
        },
        "test_exact_costs.py",
    )
    base = preset("campaign")
    for space, objective in ((rule, PHOTOGRAPHS), (SPACE, Objective("costs.flight_time_s", "minimise"))):
        make = functools.partial(space.config, base)
        assert exact_cost(space, make, space.default(base), objective) is None


def test_a_mission_that_ran_out_of_views_says_otherwise() -> None:
    found = photographs()
    values = {"seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.5}
    history = [Observation(0, values, "r0", 0, -26.0, second=99.0)]
    assert Exact(found).agreed(history).first is found
    short = Observation(1, values, "r1", 0, -23.0, second=97.0)
    assert Exact(found).agreed([*history, short]).first is None
