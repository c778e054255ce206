"""Options of our optimiser: sparsity, a cheaper fidelity, two objectives."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable
from pathlib import Path

import fake_campaigns
import numpy as np
import pytest
import synthetic
from fake_campaigns import FIDELITY

from nbv.errors import UserError
from tuner.acquisition.front import flown_in_both, propose_for_front, two_models
from tuner.acquisition.pareto import pareto_front
from tuner.campaign.campaign import Campaign
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.problem.space_files import load_search_space
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings, surrogate_settings

settings = functools.partial(fake_campaigns.settings, initial=4)
run = functools.partial(fake_campaigns.run, initial=4)


# -- sparsity ------------------------------------------------------------------------------------------------


def test_sparse_model_switches_parameters_off() -> None:
    """Only the first parameter matters; the sparse prior knows it from fewer missions."""
    rng = np.random.default_rng(1)
    history = []
    for i in range(24):
        u = rng.random(2)
        y = math.sin(6 * u[0]) + 0.05 * rng.normal()
        history.append(Observation(i, synthetic.SPACE.from_unit(u), "r0", 0, y, y))
    ratio = {}
    for sparse in (False, True):
        model = RockMeanGP(synthetic.SPACE, history, ("r0",), settings=SurrogateSettings(sparse=sparse))
        first, second = model.lengthscales.values()
        ratio[sparse] = second / first
    assert ratio[True] > 10 and ratio[True] > ratio[False]


@pytest.mark.parametrize(
    ("space", "sparse"), [("gate_and_weights", False), ("beyond_paper", False), ("full", True)]
)
def test_most_of_many_parameters_are_expected_to_have_no_effect(space: str, sparse: bool) -> None:
    shipped = load_search_space(space)
    assert surrogate_settings(shipped).sparse is sparse
    assert surrogate_settings(shipped).trend is sparse


# -- a cheaper fidelity -----------------------------------------------------------------------------------------------


def cheap(values: Values, rock: str) -> float | None:
    return 3 * synthetic.true_value(values) + (1.0 if rock == "r1" else 0.0)


def misleading(values: Values, rock: str) -> float | None:
    u = synthetic.SPACE.to_unit(values)
    return math.sin(9 * u[0]) * math.cos(11 * u[1])


def flown_before(fly: Callable[[Values, str], float | None], missions: int = 96) -> EarlierMissions:
    """Anywhere in the space, rocks and two replicates in turn."""
    rng, rocks = np.random.default_rng(3), synthetic.ROCKS
    history = []
    for i, u in enumerate(rng.random((missions, 2))):
        values, rock = synthetic.SPACE.from_unit(u), rocks[i % len(rocks)]
        y = fly(values, rock)
        history.append(Observation(i, values, rock, i // len(rocks) % 2, y, y))
    return EarlierMissions(synthetic.SPACE, rocks, tuple(history))


@pytest.mark.slow
def test_agreeing_landscape_is_used_and_a_misleading_one_is_not() -> None:
    history = synthetic.random_design(12, 0.05, 0)
    good = RockMeanGP(synthetic.SPACE, history, synthetic.ROCKS, feature=flown_before(cheap).feature)
    bad = RockMeanGP(synthetic.SPACE, history, synthetic.ROCKS, feature=flown_before(misleading).feature)
    alone = RockMeanGP(synthetic.SPACE, history, synthetic.ROCKS)
    assert good.uses_feature and not bad.uses_feature and not alone.uses_feature
    points = [synthetic.SPACE.from_unit(u) for u in np.random.default_rng(5).random((200, 2))]
    truth = np.array([synthetic.true_rock_mean(v) for v in points])
    best = truth > np.quantile(truth, 0.75)  # the search went there
    error, error_alone = (model.posterior(points).mean - truth for model in (good, alone))
    assert np.std(error) < 0.7 * np.std(error_alone)
    assert np.std(error[best]) < 0.6 * np.std(error_alone[best])


def test_the_best_before_are_apart_and_failures_do_no_harm() -> None:
    flown = flown_before(
        lambda values, rock: None if values["gate.budget_fraction"] < 0.2 else cheap(values, rock)
    )
    best = flown.best(4)
    unit = np.array([synthetic.SPACE.to_unit(v) for v in best])
    assert len(best) == 4 and synthetic.true_value(best[0]) > 0.95
    assert {o.replicate for o in flown.observations} >= {0, 1}
    assert min(np.linalg.norm(unit[i] - unit[j]) for i in range(4) for j in range(i)) > 0.15
    assert not flown_before(lambda values, rock: None).usable
    read = EarlierMissions.from_json(flown.to_json(), synthetic.SPACE)
    assert read.best(4) == best


# -- two objectives ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_front_is_sought_and_found() -> None:
    """First: u; second: 1 - u^2, minus what the other parameter wastes. The front is all u, at v = 0."""
    rng = np.random.default_rng(0)

    def fly(i: int, values: Values) -> Observation:
        u, v = synthetic.SPACE.to_unit(values)
        y = [u - 0.5 * v + 0.01 * rng.normal(), 1 - u**2 - v + 0.01 * rng.normal()]
        return Observation(i, values, "r0", 0, y[0], y[0], second=y[1])

    history = [fly(i, synthetic.SPACE.from_unit(u)) for i, u in enumerate(rng.random((8, 2)))]
    for i in range(6):
        models = two_models(synthetic.SPACE, history, ("r0",), i)
        values, figures = propose_for_front(models, [], i)
        assert np.isfinite(figures["log_nehvi"])
        history.append(fly(8 + i, values))
    proposed = np.array([synthetic.SPACE.to_unit(o.values) for o in history[8:]])
    assert np.median(proposed[:, 1]) < 0.1 and np.ptp(proposed[:, 0]) > 0.4
    objectives = (Objective("first"), Objective("second", "minimise"))
    points = flown_in_both(
        two_models(synthetic.SPACE, history, ("r0",), 0), objectives, synthetic.SPACE, history
    )
    front = pareto_front(points, objectives)
    assert len(points) == 14 and all(
        any(q.first >= p.first and q.second <= p.second for q in front) for p in points
    )
    firsts, seconds = [p.first for p in front], [-p.second for p in front]
    assert len(front) >= 4
    assert firsts == sorted(firsts, reverse=True) and seconds == sorted(seconds)


@pytest.mark.slow
def test_campaign_with_two_objectives(tmp_path: Path) -> None:
    campaign = run(tmp_path / "run", second=Objective("costs.images", "minimise"))
    assert campaign.trials()[-1].why["phase"] == "front"
    assert campaign.history()[0].second == -32.0
    assert json.loads((tmp_path / "run" / "front.json").read_text())[0]["second"] == pytest.approx(32.0)
    assert Campaign.open(tmp_path / "run", fidelity=FIDELITY).settings.second == Objective(
        "costs.images", "minimise"
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sampler": "tpe", "second": Objective("costs.images")}, "needs sampler gp, not tpe"),
        ({"second": Objective("costs.images"), "learn_from": ("runs/a",)}, "cannot be combined"),
    ],
)
def test_options_that_make_no_sense_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        settings(**changes)


@pytest.mark.slow
def test_status_lists_the_front_with_numbers_in_full(gatetune, tmp_path: Path) -> None:
    campaign = run(tmp_path / "run", second=Objective("whole.completeness_48mm", "minimise"))
    code, out, _ = gatetune("campaign", "status", "run")
    assert code == 0
    for point in campaign.front(save=False):
        assert f"{point.first:.3f} ± {point.first_sd:.3f}".replace("-", "−") in out
    assert "F-score @ 48 mm (%)" in out and "Completeness @ 48 mm (%)" in out and "f_b " in out
