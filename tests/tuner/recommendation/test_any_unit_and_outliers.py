import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
import synthetic
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tuner.problem.goal import Goal, Objective
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Parameter, Problem, SearchSpace
from tuner.problem.standardise import winsorised
from tuner.recommendation.choose import recommend
from tuner.recommendation.recommendation import Recommendation
from tuner.report.labels import decimals_for, format_number
from tuner.samplers.registry import make_sampler

LINE = SearchSpace("line", (Parameter("x", "float", default=0.1),))
MISSIONS = synthetic.random_design(16, 0.05, 0, 2)


@functools.cache
def answers(a: float, b: float) -> list[Any]:
    """What is proposed and recommended where every outcome y is a y + b."""
    outcomes = [a * o.outcome + b for o in MISSIONS if o.outcome is not None]
    history = [dataclasses.replace(o, outcome=y, raw=y) for o, y in zip(MISSIONS, outcomes)]
    proposal = make_sampler("gp", synthetic.sampler_settings(0, 4)).ask(history, [])
    best = recommend(synthetic.PROBLEM, Goal(), history, only_verified=False)["tuned"]
    return [proposal.values, best.values, round(best.improvement / float(np.ptp(outcomes)), 5)]


@settings(max_examples=6, deadline=None)
@given(st.floats(-12, 12), st.floats(-1e6, 1e6))
@example(12.0, 0.0)
@example(-12.0, 0.0)
@example(0.0, 1e9)
def test_proposals_and_recommendation_do_not_depend_on_the_unit(exponent: float, shift: float) -> None:
    a = 10.0**exponent
    assert answers(a, a * shift if abs(shift) < 1e7 else shift) == answers(1.0, 0.0)


class RepeatableProblem(Problem):
    """Missions over photographs that were taken before."""

    @property
    def repeatable(self) -> tuple[Instance, ...]:
        return self.instances


def on_a_line(wild: dict[int, float], kind: type[Problem] = Problem) -> Recommendation:
    """20 missions of -(x - 0.3)^2, the default first, some with another outcome."""
    places = [0.1, *(np.arange(19) + 0.5) / 19]
    outcomes = [wild.get(i, -((x - 0.3) ** 2)) for i, x in enumerate(places)]
    history = [Observation(i, {"x": x}, "one", 0, y, y) for i, (x, y) in enumerate(zip(places, outcomes))]
    best = recommend(kind(LINE, (Instance("one"),), {"x": 0.1}), Goal(Objective("q")), history)["tuned"]
    return best


def test_where_missions_repeat_exactly_nothing_is_left_out() -> None:
    """The default's own bad outcome counts: run again it would be the same."""
    assert on_a_line({0: -0.3}).outliers
    best = on_a_line({0: -0.3}, RepeatableProblem)
    assert not [o for o in best.outliers if o.counts_as is None]
    assert best.default_mean < on_a_line({0: -0.3}).default_mean


@pytest.mark.parametrize(
    ("outcome", "where"),
    [(-0.3, 0), (-1.0, 7), (-10.0, 13), (-1e12, 0), (-1e300, 7), (0.2, 0), (0.2, 13), (1.0, 7), (1e12, 13)],
)
def test_one_outlier_of_any_size_moves_the_recommendation_by_less_than_a_twentieth(
    outcome: float, where: int
) -> None:
    best = on_a_line({where: outcome})
    assert abs(best.values["x"] - 0.3) <= 0.05
    assert -0.5 < best.default_mean <= best.mean <= 0.0
    (outlier,) = best.outliers
    assert (outlier.mission, outlier.measured, outlier.counts_as) == (where, outcome, None)


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 2.0, 3.0, 4.0]),
        ([0.0, 1.0, 2.0, 3.0, -1e12], [0.0, 1.0, 2.0, 3.0, -6.0]),  # two ranges away
        ([0.0, 1.0, 2.0, 3.0, 1e12], [0.0, 1.0, 2.0, 3.0, 9.0]),
        ([0.0] * 17 + [0.5, 1.0, 90.0], [0.0] * 17 + [0.5, 1.0, 3.0]),
        ([0.0] * 17 + [0.5, 90.0, 91.0], [0.0] * 17 + [0.5, 90.0, 91.0]),  # two are accepted
        ([*np.linspace(0, 1, 17), -99.0, -99.0, -99.0], [*np.linspace(0, 1, 17), -2.0, -2.0, -2.0]),
        ([1.0] * 9, [1.0] * 9),
        ([90.0] * 18 + [91.0, -1e6], [90.0] * 18 + [91.0, 88.0]),  # three different outcomes
        ([90.0] * 18 + [89.0, 1e6], [90.0] * 18 + [89.0, 92.0]),
        ([90.0] * 17 + [89.0, 91.0, 91.0], [90.0] * 17 + [89.0, 91.0, 91.0]),
        ([100.0] * 19 + [0.0], [100.0] * 19 + [0.0]),  # two: nothing says how far is far
        ([98.1, 98.1 + 2e-9, 98.1 - 2e-9, 98.2, 98.0], [98.1, 98.1, 98.1, 98.2, 98.0]),  # three are the same
        ([], []),
    ],
)  # fmt: skip
def test_what_is_accepted(outcomes: list[float], expected: list[float]) -> None:
    assert winsorised(["r"] * len(outcomes), outcomes) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("number", "spread", "text"),
    [
        (94.567, 0.4, "94.57"),
        (94.567, 40.0, "94.6"),
        (1e-8, 2e-11, "1.0000e−8"),
        (-3.2e-12, 1e-8, "0"),
        (1e9 + 0.25, 0.1, "1000000000.25"),
    ],
)
def test_numbers_have_the_digits_that_their_spread_deserves(number: float, spread: float, text: str) -> None:
    assert format_number(number, decimals_for(spread)) == text


def test_a_rock_that_gains_more_than_the_others_is_no_outlier() -> None:
    """Three missions a rock: the default and twice the same change, worth one point on five rocks and 2.4 on the sixth."""
    rocks = [f"rock-{k}" for k in range(6)]
    history = [
        Observation(3 * k + i, {"x": x}, rock, 0, y, y)
        for k, rock in enumerate(rocks)
        for i, x in enumerate((0.1, 0.3, 0.30001))
        for y in [90.0 + k + (i > 0) * (2.4 if k == 5 else 1.0)]
    ]
    problem = Problem(LINE, tuple(map(Instance, rocks)), {"x": 0.1})
    best = recommend(problem, Goal(Objective("q")), history)["tuned"]
    assert best.outliers == ()
    assert best.improvement == pytest.approx((5 * 1.0 + 2.4) / 6, abs=0.2)
