"""What earned a gain: the steps add up to it, and strategies that took the same photographs are found."""

import itertools

import numpy as np
import pytest

from tuner.evaluation.comparison import MetricRow, same_photographs, strategy_difference
from tuner.evaluation.earned import believed_gains, measured_steps
from tuner.missions.job import Trial
from tuner.problem.baselines import TUNED, TUNED_POOL_HYB_H, TUNED_WEIGHTS
from tuner.problem.groups import B_AWARE, COVIS, OTHER, POOL, SEEDS, STOP, THRESHOLDS, grouped
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.space_files import load_search_space
from tuner.recommendation.choose import recommend
from tuner.recommendation.inputs import CampaignData, Goal
from tuner.surrogate.model import InstanceMeanGP

ROW = MetricRow("", "F", "observable.f", "%", True)
LEVELS = {"hyb-h": 90.0, TUNED_POOL_HYB_H: 92.0, TUNED_WEIGHTS: 92.5, TUNED: 93.5}


def records(levels, photographs=lambda name, k: f"{name} {k}"):
    return [
        Trial(
            rock=rock,
            replicate=k,
            strategy=name,
            status="ok",
            photographs=photographs(name, k),
            measured_then={"metrics": {"observable": {"f": level + 0.1 * k}}, "costs": {}},
        )
        for (name, level), rock, k in itertools.product(levels.items(), ("a", "b", "c"), (0, 1))
    ]


@pytest.mark.parametrize(
    "changed, strategies, steps",
    [
        (("pool.max_altitude_m", "covis.weights.nov", "gate.d95_m"), [*LEVELS], [2.0, 0.5, 1.0]),
        (("pool.max_altitude_m", "gate.d95_m"), ["hyb-h", TUNED_POOL_HYB_H, TUNED], [2.0, 1.5]),
        (("covis.weights.nov", "b_aware.weights.nov"), ["hyb-h", TUNED], [3.5]),
    ],
)
def test_steps_add_up_to_the_gain(changed, strategies, steps):
    trials = records({name: LEVELS[name] for name in strategies})
    found = measured_steps(trials, strategies, "hyb-h", ROW, changed)
    assert [step.difference.interval.mean for step in found] == pytest.approx(steps)
    whole = strategy_difference(trials, TUNED, "hyb-h", ROW).interval.mean
    assert sum(steps) == pytest.approx(whole)
    named = " ".join(step.what for step in found)
    assert all(group in named for group in grouped(changed))


def test_the_same_photographs_everywhere_are_found_and_once_is_not_enough():
    names = ["covis", "b-aware", "hyb-h"]
    everywhere = records(
        dict.fromkeys(names, 90.0), lambda name, k: "one" if name != "covis" else f"covis {k}"
    )
    assert same_photographs(everywhere, names) == {"hyb-h": "b-aware"}
    once = records(dict.fromkeys(names, 90.0), lambda name, k: "one" if k == 0 else name)
    assert same_photographs(once, names) == {}


def test_groups_cover_every_path():
    paths = ["gate.d95_m", "covis.weights.nov", "matchable.views", "pool.max_altitude_m", "seed.count"]
    found = grouped([*paths, "stop.adaptive_budget", "dense.neighbours"])
    assert list(found) == [THRESHOLDS, COVIS, B_AWARE, POOL, SEEDS, STOP, OTHER]


def test_the_model_gives_the_gain_to_the_group_that_has_it():
    """Only the pool matters to this outcome: its group alone has the whole gain, and the others none without it."""
    space = load_search_space("gate_weights_and_pool")
    rng = np.random.default_rng(3)
    default = {p.path: p.default if p.default is not None else p.from_unit(0.5) for p in space.parameters}
    history = []
    for number in range(24):
        values = default if number < 4 else space.from_unit(rng.random(space.dimension).tolist())
        outcome = -3.0 * space.to_unit(values)[space.paths.index("pool.max_altitude_m")]
        outcome += 0.01 * rng.standard_normal()
        history.append(Observation(number, values, "ab"[number % 2], number // 2 % 2, outcome, outcome))
    data = CampaignData(space, history, ("a", "b"), default, only_verified=False)
    best = recommend(data, Goal(Objective()))
    assert best is not None and "pool.max_altitude_m" in best.changed
    for gain in believed_gains(InstanceMeanGP(space, history, ("a", "b")), best):
        part = gain.alone if gain.group == POOL else gain.rest
        assert part[0] == pytest.approx(best.improvement, abs=0.25)
        low, high = part[1]
        assert low < part[0] < high
