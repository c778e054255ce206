import itertools
from collections.abc import Sequence

import fake_campaigns
import numpy as np
import pytest
import synthetic

from tuner.problem.goal import Goal, parse_goal
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Problem, Values
from tuner.problem.space_files import load_search_space
from tuner.recommendation.choose import may_be_recommended, recommend
from tuner.recommendation.recommendation import Recommendation

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
def test_two_rocks_and_two_replicates_or_all_there_are(
    rocks: Sequence[str | Instance], replicates: int, blocks: list[tuple[str, int]], expected: bool
) -> None:
    instances = tuple(Instance(rock) if isinstance(rock, str) else rock for rock in rocks)
    problem = Problem(synthetic.SPACE, instances, FAIR, replicates)
    may = may_be_recommended(problem, missions(GOOD, 1.0, *blocks), [GOOD, FAIR])
    assert may == [expected, True]  # the default always


def test_a_lead_that_ran_too_seldom_waits() -> None:
    def after(rocks: tuple[str, ...], once: list[Observation]) -> Recommendation | None:
        blocks = [(rock, k) for rock in rocks for k in (0, 1)]
        twice = [o for y in (50.0, 50.2) for o in missions(synthetic.DEFAULT, y, *blocks)]
        return recommended([*twice, *once], rocks, replicates=2)

    found = after(ROCKS, missions(GOOD, 60.0, ("r2", 1)))
    assert found.keep_default
    found = after(("r0",), missions(GOOD, 60.0, ("r0", 0), ("r0", 1)))
    assert found.values == GOOD


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
