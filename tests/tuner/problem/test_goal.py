import dataclasses
import functools
from typing import Any

import fake_campaigns
import pytest

from nbv.config import preset
from nbv.errors import UserError
from tuner.problem.deterministic_metrics import DeterministicMetric, DeterministicMetrics, photographs_metric
from tuner.problem.goal import parse_goal
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.space_files import load_search_space, space_from_dict

PHOTOGRAPHS = Objective("costs.images", "minimise")


def test_the_text_says_metric_cost_and_limit_and_is_said_back() -> None:
    assert parse_goal("f_score").second is None
    cheap = parse_goal("completeness@energy<=9")
    assert cheap.second == Objective("costs.energy_wh", "minimise") and cheap.limit == 9.0
    best = parse_goal("observable.f_score_16mm@photographs<=21")
    assert (best.objective.metric, best.second, best.limit) == ("observable.f_score_16mm", PHOTOGRAPHS, 21.0)
    least = parse_goal("photographs@f_score >= 97.5")
    assert least.objective == PHOTOGRAPHS and least.second == Objective() and least.limit == 97.5
    assert str(least) == "photographs@f_score>=97.5"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("photographs@P(f_score>=98)>=0.95", "is not understood"),
        ("f_score@photographs>=21", "costs.images is minimised; write <="),
        ("photographs@f_score<=97", "is maximised; write >="),
        ("f_score@f_score>=9", "the same metric twice"),
        ("f_score@photographs<=1e", "'1e' is not a number"),
        ("f_score at 21", "is not understood; write f_score, f_score@photographs<=21"),
        ("f_score@photographs", "is not understood; write f_score, f_score@photographs<=21"),
        ("f_score@costs.beauty<=1", "no cost 'costs.beauty'; there are costs.images"),
        ("f_score@beauty<=1", "more or less of 'beauty' is better"),
    ],
)
def test_what_is_no_objective_is_said_in_one_line(text: str, says: str) -> None:
    with pytest.raises(UserError, match=says) as error:
        parse_goal(text)
    assert "\n" not in str(error.value)


SPACE = load_search_space("photographs")


def photographs(**base: Any) -> DeterministicMetric | None:
    fixed = {name.replace("__", "."): value for name, value in base.items()}
    space = dataclasses.replace(SPACE, base={**SPACE.base, **fixed})
    asked = fake_campaigns.settings(space=space, objective=PHOTOGRAPHS, second=Objective(), limit=98.0)
    return asked.goal.exact.first


def test_photographs_are_seeds_and_planned_views() -> None:
    found = photographs()
    assert found is not None and found.paths == ("seed.count", "stop.adaptive_budget")
    values = {"seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.5}
    assert found.of(values) == 26.0 and found.outcome(values) == -26.0
    assert found.of({**values, "seed.count": 20, "stop.adaptive_budget": 0}) == 20.0
    cut = photographs(stop__max_photographs=30)
    most = {**values, "seed.count": 24}
    assert cut is not None and cut.of(values) == 26.0 and cut.of(most) == 30.0


def test_what_a_mission_may_cut_short_and_flight_time_are_not_known() -> None:
    assert photographs(stop__criterion="both") is None is photographs(stop__criterion="predicted")
    stop = {"stop.criterion": {"kind": "categorical", "choices": ["budget", "both"]}}
    rule = space_from_dict({"name": "rule", "base": {"gate.kind": "hyb-h"}, "parameters": stop}, "test")
    base = preset("campaign")
    for space, objective in ((rule, PHOTOGRAPHS), (SPACE, Objective("costs.flight_time_s", "minimise"))):
        make = functools.partial(space.config, base)
        assert photographs_metric(space, make, space.default(base), objective) is None


def test_a_mission_that_ran_out_of_views_says_otherwise() -> None:
    found = photographs()
    values = {"seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.5}
    history = [Observation(0, values, "r0", 0, -26.0, second=99.0)]
    assert DeterministicMetrics(found).confirmed_by(history).first is found
    short = Observation(1, values, "r1", 0, -23.0, second=97.0)
    assert DeterministicMetrics(found).confirmed_by([*history, short]).first is None
