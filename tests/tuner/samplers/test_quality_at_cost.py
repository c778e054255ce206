import dataclasses
import functools

import fake_campaigns
import numpy as np
import pytest
import torch

from nbv.errors import UserError
from tuner.acquisition.constrained import Constraint, propose_constrained, two_models
from tuner.problem.goal import Goal, Objective
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import Problem, Values
from tuner.problem.space_files import space_from_dict
from tuner.recommendation.choose import recommend
from tuner.recommendation.recommendation import Recommendation

PHOTOGRAPHS = Objective("costs.images", "minimise")
VARIED = {
    "photographs": {"kind": "int", "low": 26, "high": 36, "default": 32},
    "pool.max_altitude_m": {"low": 1.45, "high": 4.0, "default": 4.0},
}
FIXED = {"gate.kind": "hyb-h", "stop.criterion": "budget"}
SPACE = space_from_dict({"name": "few", "base": FIXED, "parameters": VARIED}, "test")
PROBLEM = Problem(
    SPACE, (Instance("r0"), Instance("r1")), SPACE.default(fake_campaigns.settings(space=SPACE).problem.base)
)
settings = functools.partial(fake_campaigns.settings, space=SPACE, sampler="gp", second=PHOTOGRAPHS)


def test_a_limit_that_no_mission_can_keep_is_refused() -> None:
    with pytest.raises(UserError, match="limit of 25 photographs is below the 26 that"):  # 24 seeds, 2 views
        settings(limit=25.0)
    assert [settings(limit=at).goal.at_least for at in (26.0, 26.5)] == [-26.5, -26.5]  # 27 is too many
    with pytest.raises(UserError, match="a limit is of a second objective"):
        settings(second=None, limit=40.0)


def run_missions(number: int, values: Values, rng: np.random.Generator) -> Observation:
    """More photographs are better, and the second parameter u is best at 0.3."""
    photographs = float(values["photographs"])
    u = SPACE.to_unit(values)[1]
    y = 80.0 + photographs / 4 - 10 * (u - 0.3) ** 2 + 0.1 * rng.normal()
    return Observation(number, values, f"r{number % 2}", 0, y, y, second=-photographs)


def advise(history: list[Observation], limit: float, *, least_cost: bool = False) -> Recommendation:
    goal = Goal(Objective(), PHOTOGRAPHS, limit)
    if least_cost:  # the other way round
        goal = Goal(PHOTOGRAPHS, Objective(), limit)
        history = [dataclasses.replace(o, outcome=o.second, second=o.outcome) for o in history]
    return recommend(PROBLEM, goal, history, only_verified=False)["tuned"]


def test_best_quality_within_a_number_of_photographs() -> None:
    rng = np.random.default_rng(0)
    history = [run_missions(i, SPACE.from_unit(u), rng) for i, u in enumerate(rng.random((8, 2)))]
    for i in range(8, 16):
        models = two_models(PROBLEM, history)
        values, _ = propose_constrained(models[0], Constraint(models[1], -30.5), [], i)
        history.append(run_missions(i, values, rng))
    searched = [o.values["photographs"] for o in history[8:]]
    assert max(searched) <= 31 and searched.count(30) >= 2  # at the limit, where it is best
    result = advise(history, 30.0)
    assert result.values["photographs"] <= 30 and result.limit is not None and result.limit.satisfied
    assert abs(SPACE.to_unit(result.values)[1] - 0.3) < 0.2
    assert Recommendation.from_dict(result.to_dict()) == result


def test_least_cost_of_a_quality_and_one_out_of_reach() -> None:
    rng = np.random.default_rng(1)
    history = [run_missions(i, SPACE.from_unit(u), rng) for i, u in enumerate(rng.random((24, 2)))]
    result = advise(history, 87.0, least_cost=True)
    assert result.limit is not None and result.limit.satisfied and result.limit.mean >= 87.0
    cheaper = [o for o in history if -(o.second or 0.0) < result.mean - 1]
    assert cheaper and np.mean([o.outcome for o in cheaper]) < 87.0
    never = advise(history, 99.0, least_cost=True)
    assert never.limit is not None and not never.limit.satisfied and never.limit.probability < 0.05


def test_a_proposal_within_a_modelled_limit_is_a_function_of_the_ledger() -> None:
    """BoTorch draws from torch's global state where no point in flight may keep the limit."""
    rng, history = np.random.default_rng(5), list[Observation]()
    for i, u in enumerate(rng.random((16, 2))):
        y = float(90 - 5 * np.mean((u - 0.4) ** 2) + 0.3 * rng.normal())
        second = float(50 - 10 * u[1] + 0.5 * rng.normal())
        history.append(Observation(i, SPACE.from_unit(u), f"r{i % 2}", i // 2 % 2, y, y, second=second))
    models = two_models(PROBLEM, history)
    running, found = [SPACE.from_unit(np.array([0.3, 0.2]))], []
    for state in (1, 2):
        torch.manual_seed(state)
        before = torch.get_rng_state()
        found.append(propose_constrained(models[0], Constraint(models[1], 46.0), running, 3))
        assert torch.equal(torch.get_rng_state(), before)
    assert found[0] == found[1]
