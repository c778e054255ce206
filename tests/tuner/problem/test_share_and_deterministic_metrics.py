import dataclasses
import functools
import itertools
from typing import Any

import fake_campaigns
import numpy as np
import pytest
from scipy import stats

from nbv.config import preset
from nbv.errors import UserError
from tuner.acquisition.constrained import Constraint
from tuner.campaign.settings_file import resolved_settings
from tuner.problem.deterministic_metrics import DeterministicMetric, DeterministicMetrics, photographs_metric
from tuner.problem.goal import parse_goal
from tuner.problem.instances import Instance
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.problem.share import ShareEstimate
from tuner.problem.space_files import load_search_space, space_from_dict
from tuner.recommendation.choose import Choice
from tuner.surrogate.model import InstanceMeanGP

PHOTOGRAPHS = Objective("costs.images", "minimise")
TEXT = "photographs@P(f_score>=98)>=0.95"


def test_the_text_says_metric_cost_and_limit_and_is_said_back() -> None:
    assert parse_goal("f_score").second is None
    cheap = parse_goal("completeness@energy<=9")
    assert cheap.second == Objective("costs.energy_wh", "minimise") and cheap.limit == 9.0
    best = parse_goal("observable.f_score_16mm@photographs<=21")
    assert (best.objective.metric, best.second, best.limit) == ("observable.f_score_16mm", PHOTOGRAPHS, 21.0)
    least = parse_goal("photographs@f_score >= 97.5")
    assert least.objective == PHOTOGRAPHS and least.second == Objective() and least.limit == 97.5
    asked = parse_goal(" photographs @ P( f_score >= 98 ) >= 0.95 ")
    assert asked.objective.metric == "costs.images"
    assert asked.second is not None and asked.second.is_share
    assert (asked.second.metric, asked.second.direction) == ("P(observable.f_score_48mm>=98)", "maximise")
    assert asked.limit == pytest.approx(95.0)
    assert str(asked) == TEXT


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("photographs@P(f_score>=98)>=1.0", "a share is above 0 and below 1, not 1; no number of rocks"),
        ("photographs@P(f_score>=98)>=95", "a share is above 0 and below 1, not 95"),
        ("photographs@P(f_score>=98)<=0.95", "write >="),
        ("photographs@P(f_score)>=0.95", r"the share of rocks that reach 98 is P\(f_score>=98\)"),
        ("f_score@P(photographs>=20)>=0.95", "less of costs.images is better"),
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


def settings_of(rocks: list[str], **more: object):
    return resolved_settings(
        {"rocks": rocks, "space": "photographs", "fidelity": "geometric", "objective": TEXT, **more}, "test"
    )


def test_few_rocks_cannot_show_a_share() -> None:
    with pytest.raises(UserError, match="3 rocks cannot show what 95 % of rocks reach, 16 can"):
        settings_of(["slab", "vesicular", "cavern"])
    settings = settings_of(["any-slab"])
    assert settings.goal.at_least == pytest.approx(95.0) and settings.goal.exact.first is not None
    with pytest.raises(UserError, match="a share is above 0 and below 1"):
        second = {"metric": "P(observable.f_score_48mm>=98)", "direction": "maximise"}
        settings_of(["any-slab"], objective="photographs", second=second, limit=100.0)
    with pytest.raises(UserError, match=r"no metric 'P\(observable.f_score_47mm>=98\)'; did you mean"):
        settings_of(["any-slab"], objective="photographs@P(observable.f_score_47mm>=98)>=0.9")


def test_a_belief_is_that_of_the_rocks_flown() -> None:
    belief = ShareEstimate(57 / 58, 58)
    posterior = stats.beta(57.5, 1.5)
    assert belief.interval_95 == pytest.approx(posterior.interval(0.95))
    assert belief.sd == pytest.approx(posterior.std())
    assert belief.probability(0.95) == pytest.approx(posterior.sf(0.95))
    next_ones = stats.betabinom(100, 57.5, 1.5)
    assert belief.predictive_interval() == (next_ones.ppf(0.025), next_ones.ppf(0.975))
    assert ShareEstimate(1.0, 3).interval_95[1] == 1.0 and ShareEstimate(0.0, 3).interval_95[0] == 0.0


ONE = SearchSpace("one", (Parameter("seed.count", "int", 8, 40, "linear", (), 24),), {})


@pytest.mark.parametrize(("rocks", "kept"), [(4, False), (60, True)])
def test_where_all_succeed_many_rocks_are_believed_and_few_are_not(rocks: int, kept: bool) -> None:
    """Fresh rocks at two numbers of photographs; of 12 a fifth succeeds."""
    rng, missions = np.random.default_rng(0), list[Observation]()
    for number in range(2 * rocks):
        count, share = (12, 0.2) if number < rocks else (36, 1.0)
        outcome = 100.0 * (rng.random() < share)
        missions.append(Observation(number, {"seed.count": count}, "any-slab", number, outcome, outcome))
    constraint = Constraint(InstanceMeanGP(ONE, missions, [Instance("any-slab")]), 95.0, is_share=True)
    assert constraint.keeps([{"seed.count": 36}, {"seed.count": 12}]) == [kept, False]


def test_a_share_is_of_all_rocks_that_were_run_though_nearly_all_succeed() -> None:
    """Three plans on 24 rocks each: where none fails that is shown, and the few that fail are no outliers."""
    rocks = ["any-cleft", "any-slab"]
    s = settings_of(rocks, objective="photographs@P(f_score>=98)>=0.9", sampler="gp")
    for fail in ([], [(8, 5), (6, 17), (4, 20)]):
        missions = list[Observation]()
        for planned, k in itertools.product((8, 6, 4), range(24)):
            values = {**s.problem.default, "stop.adaptive_budget": planned}
            images, reached = float(values["seed.count"] + planned), 100.0 * ((planned, k) not in fail)
            block = (rocks[k % 2], k // 2, -images, images)
            missions.append(Observation(len(missions), values, *block, second=reached))
        choice = Choice(s.problem, s.goal.after(missions), missions, only_verified=True)
        shares = choice.constraint.shares([c.values for c in choice.candidates])
        assert not choice.outliers and np.mean([e.share for e in shares]) == pytest.approx(
            1.0 - len(fail) / 72, abs=0.01
        )
        assert fail or all(c.keeps for c in choice.candidates)


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
