"""What is recommended: the best, not the luckiest, in any unit, whatever one outlier says."""

import dataclasses
import functools
import itertools
from typing import Any

import fake_campaigns
import numpy as np
import pytest
import synthetic
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tuner.problem.goal import Goal, Objective, parse_goal
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Parameter, Problem, SearchSpace, Values
from tuner.problem.space_files import load_search_space
from tuner.problem.standardise import winsorised
from tuner.recommendation.choose import may_be_recommended, recommend
from tuner.recommendation.recommendation import Recommendation
from tuner.samplers.base import make_sampler

ROCKS = ("r0", "r1", "r2")


def recommended(
    observations: list[Observation],
    rocks: tuple[str, ...] = ROCKS,
    replicates: int = 1,
    *,
    only_verified: bool = True,
) -> Recommendation | None:
    problem = Problem(synthetic.SPACE, tuple(map(Instance, rocks)), synthetic.DEFAULT, replicates)
    return recommend(problem, Goal(), observations, only_verified=only_verified).get("tuned")


def test_picks_the_best_not_the_luckiest() -> None:
    """A good configuration, run often with ordinary luck, against a poor one with one lucky mission."""
    rng = np.random.default_rng(0)
    good = synthetic.SPACE.from_unit([0.75, 0.3])
    poor = synthetic.SPACE.from_unit([0.1, 0.95])
    history = [Observation(i, good, "r0", i, 60 + rng.normal(), None) for i in range(12)]
    history += [Observation(12 + i, poor, "r0", i, 50 + rng.normal(), None) for i in range(11)]
    history.append(Observation(23, poor, "r0", 11, 75.0, None))  # the luckiest of all
    assert max(history, key=lambda o: o.outcome or 0).values == poor
    result = recommended(history, ("r0",), only_verified=False)
    assert result.values == good
    assert result.mean == pytest.approx(60, abs=2.5)
    assert result.missions == 12


def test_failures_are_counted_and_never_recommended() -> None:
    good, bad = synthetic.SPACE.from_unit([0.2, 0.2]), synthetic.SPACE.from_unit([0.9, 0.9])
    history = [Observation(i, good, "r0", i, 1.0 + 0.1 * i) for i in range(3)]
    history += [Observation(3 + i, bad, "r0", i, reason="seed_model_failed") for i in range(3)]
    found = recommended(history, ("r0",), only_verified=False)
    assert (found.values, found.failures, found.observations) == (good, 3, 3)
    assert recommended(history[3:], ("r0",)) is None


GOOD, FAIR = synthetic.SPACE.from_unit([0.7, 0.3]), synthetic.SPACE.from_unit([0.2, 0.8])


def missions(values: Values, outcome: float | None, *blocks: tuple[str, int]) -> list[Observation]:
    return [Observation(0, values, rock, k, outcome, outcome) for rock, k in blocks]


@pytest.mark.parametrize(
    ("rocks", "replicates", "blocks", "expected"),
    [
        (ROCKS, 2, [("r0", 0)], False),
        (ROCKS, 2, [("r0", 0), ("r0", 1)], False),
        (ROCKS, 2, [("r0", 0), ("r1", 0)], False),
        (ROCKS, 2, [("r0", 0), ("r1", 1)], True),
        (ROCKS, 1, [("r0", 0), ("r1", 0)], True),  # the campaign has one replicate
        (("r0",), 2, [("r0", 0), ("r0", 1)], True),  # and here one rock
        (("r0",), 1, [("r0", 0)], True),
        (ROCKS, 2, [("r0", 0), ("elsewhere", 1)], False),
        ([Instance("r0", c) for c in ("ideal", "field")], 1, [("r0", 0)], False),  # one of two conditions
    ],
)
def test_two_rocks_and_two_replicates_or_all_there_are(rocks, replicates, blocks, expected):
    instances = tuple(Instance(rock) if isinstance(rock, str) else rock for rock in rocks)
    problem = Problem(synthetic.SPACE, instances, FAIR, replicates)
    may = may_be_recommended(problem, missions(GOOD, 1.0, *blocks), [GOOD, FAIR])
    assert may == [expected, True]  # the default always


def test_of_two_as_good_the_one_with_fewer_changes_is_used_and_the_default_inside_the_noise() -> None:
    def of(gain: float, seed: int) -> Recommendation:
        """The first parameter alone matters."""
        rng, history = np.random.default_rng(seed), []
        first = synthetic.SPACE.paths[0]
        few = {**synthetic.DEFAULT, first: GOOD[first]}
        for i in range(36):
            values = (synthetic.DEFAULT, GOOD, few)[i % 3]
            y = 50.0 + (0.0 if values == synthetic.DEFAULT else gain) + 0.3 * rng.normal()
            history.append(Observation(i, values, ROCKS[i // 3 % 3], i // 9 % 2, y, y))
        return recommended(history, replicates=2)

    assert [len(of(5.0, seed).changed) for seed in range(3)] == [1, 1, 1]
    without_gain = [of(0.0, seed) for seed in range(3)]
    assert sum(found.keep_default for found in without_gain) >= 2
    # Else no interval says that it is better: what is flown is then decided on the missions that both flew (`tuner.answer`).
    assert all(found.improvement_interval_95[0] <= 0.0 for found in without_gain)


def test_equal_outcomes_where_both_ran_do_not_hide_that_one_is_worse_elsewhere() -> None:
    """Two changes ran in two blocks and gain 6; one change has the same there, and gains nothing in six others."""
    blocks, rng, history = [(r, k) for r in "abcd" for k in (0, 1)], np.random.default_rng(1), []
    noise = dict(zip(blocks, 90 + 0.3 * rng.normal(size=8)))
    good = synthetic.SPACE.from_unit([0.8, 0.1])
    few = {**synthetic.DEFAULT, "gate.d95_m": good["gate.d95_m"]}
    gains = {("a", 0): 6.1, ("b", 1): 5.9}
    rows = [(synthetic.DEFAULT, block, 0.0) for block in blocks]
    rows += [(good, block, gain) for block, gain in gains.items()]
    rows += [(few, block, gains.get(block, 0.5)) for block in blocks]
    for i, unit in enumerate(np.clip([0.8, 0.1] + 0.05 * rng.normal(size=(24, 2)), 0, 1)):
        rows.append((synthetic.SPACE.from_unit(unit), blocks[i % 8], 6.0))  # the search around it
    for values, (rock, k), gain in rows:
        y = noise[rock, k] + gain
        history.append(Observation(len(history), values, rock, k, y, y))
    assert recommended(history, tuple("abcd"), replicates=2).values == good


@pytest.mark.parametrize("other", [32, 34])  # as many photographs as the default takes, or more
def test_a_default_that_may_miss_the_limit_gives_way_to_what_meets_it(other: int) -> None:
    goal = parse_goal("photographs@f_score>=97")
    names = {"space": load_search_space("photographs"), "rocks": ROCKS, "replicates": 2}
    s = fake_campaigns.settings(
        **names, objective=goal.objective, second=goal.second, limit=goal.limit, sampler="gp"
    )
    default, rng, history = s.problem.default, np.random.default_rng(0), list[Observation]()
    sure = {**default, "pool.max_altitude_m": 2.0, "photographs": other}
    for values, score in ((default, 96.93), (sure, 98.5)):
        for rock, k in itertools.product(ROCKS, (0, 1)):
            images, y = values["photographs"], score + 0.5 * rng.normal()
            history.append(Observation(len(history), values, rock, k, -images, images, second=y))
    best = recommend(s.problem, s.goal, history)["tuned"]
    assert best.values == sure and best.limit.satisfied


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
def test_one_outlier_of_any_size_moves_the_recommendation_by_less_than_a_twentieth(outcome, where):
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
        ([0.0] * 17 + [0.5, 1.0, 90.0], [0.0] * 17 + [0.5, 1.0, 3.0]),
        ([0.0] * 17 + [0.5, 90.0, 91.0], [0.0] * 17 + [0.5, 90.0, 91.0]),  # two are accepted
        ([*np.linspace(0, 1, 17), -99.0, -99.0, -99.0], [*np.linspace(0, 1, 17), -2.0, -2.0, -2.0]),
        ([90.0] * 18 + [91.0, -1e6], [90.0] * 18 + [91.0, 88.0]),  # three different outcomes
        ([100.0] * 19 + [0.0], [100.0] * 19 + [0.0]),  # two: nothing says how far is far
        ([98.1, 98.1 + 2e-9, 98.1 - 2e-9, 98.2, 98.0], [98.1, 98.1, 98.1, 98.2, 98.0]),  # three are the same
        ([], []),
    ],
)  # fmt: skip
def test_what_is_accepted(outcomes: list[float], expected: list[float]) -> None:
    assert winsorised(["r"] * len(outcomes), outcomes) == pytest.approx(expected)


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
