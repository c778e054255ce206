import itertools

import pytest
from made_evaluations import made_trial

from tuner.comparison.result import measured_steps
from tuner.comparison.statistics import same_photographs, strategy_difference
from tuner.problem.baselines import TUNED, TUNED_POOL_HYB_H, TUNED_WEIGHTS, grouped
from tuner.problem.objective import DEFAULT_METRIC, Objective

LEVELS = {"hyb-h": 90.0, TUNED_POOL_HYB_H: 92.0, TUNED_WEIGHTS: 92.5, TUNED: 93.5}


def records(levels, photographs=lambda name, k: f"{name} {k}"):
    found = []
    for (name, level), rock, k in itertools.product(levels.items(), ("a", "b", "c"), (0, 1)):
        measured = {"metrics": {"observable": {"f_score_48mm": level + 0.1 * k}}, "costs": {}}
        found.append(made_trial(name, rock, k, photographs=photographs(name, k), measured=measured))
    return found


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
    found = measured_steps(trials, strategies, changed, Objective())
    assert [step.gain.mean for step in found] == pytest.approx(steps)
    whole = strategy_difference(trials, TUNED, "hyb-h", DEFAULT_METRIC).mean
    assert sum(steps) == pytest.approx(whole)
    named = " ".join(group for step in found for group in step.groups)
    assert all(group in named for group in grouped(changed))


def test_the_same_photographs_everywhere_are_found_and_once_is_not_enough():
    levels = dict.fromkeys(["covis", "b-aware", "hyb-h"], 90.0)
    everywhere = records(levels, lambda name, k: "one" if name != "covis" else f"covis {k}")
    assert same_photographs(everywhere, [*levels]) == {"hyb-h": "b-aware"}
    once = records(levels, lambda name, k: "one" if k == 0 else name)
    assert same_photographs(once, [*levels]) == {}
