import dataclasses

import pytest
import synthetic

from tuner.problem.observations import Observation
from tuner.samplers.base import initial_design_size, sobol_point
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.samplers.registry import make_sampler


@pytest.mark.parametrize(
    ("dimension", "budget", "trusted", "size"),
    [
        (2, 100, False, 6),
        (8, 24, False, 8),
        (8, 1, False, 1),
        (8, 64, True, 10),
        (18, 64, True, 12),
        (18, 64, False, 21),
        (8, 1, True, 1),
    ],
)
def test_size(dimension: int, budget: int, trusted: bool, size: int) -> None:
    assert initial_design_size(dimension, budget, trusted_default=trusted) == size


def test_every_second_point_of_a_trusted_design_is_near() -> None:
    settings = dataclasses.replace(synthetic.sampler_settings(0, 9), trusted_default=True)
    history: list[Observation] = []
    sampler = make_sampler("gp", settings)
    proposals = []
    for number in range(9):
        proposals.append(sampler.ask(history, []))
        history.append(Observation(number, proposals[-1].values, "r0", 0, 0.1 * number, 0.1 * number))
    assert proposals[0].values == synthetic.DEFAULT
    assert ["near" in p.metadata for p in proposals] == [*[False, True] * 4, False]
    sobol = [sobol_point(synthetic.SPACE, 0, i) for i in range(4)]
    assert [p.values for p in proposals[2::2]] == sobol
    assert sampler.ask(history, []).metadata["phase"] == "model"
    other = dataclasses.replace(settings, trusted_default=False)
    assert all("near" not in make_sampler("gp", other).ask(history[:n], []).metadata for n in range(1, 9))


def test_a_space_begins_where_it_says_after_the_default() -> None:
    settings = synthetic.sampler_settings(0, 9)
    path = settings.problem.space.paths[0]
    low = settings.problem.space.parameters[0].from_unit(0.0)
    space = dataclasses.replace(settings.problem.space, begin=({path: low},))
    begun = dataclasses.replace(settings, problem=dataclasses.replace(settings.problem, space=space))
    history = [Observation(0, synthetic.DEFAULT, "r0", 0, 0.5, 0.5)]
    proposal = make_sampler("gp", begun).ask(history, [])
    assert proposal.values == {**synthetic.DEFAULT, path: low} and proposal.metadata["phase"] == "begin"


@pytest.mark.parametrize(("begins", "initial"), [(1, 6), (2, 6), (4, 6), (1, 2), (3, 12), (6, 8)])
def test_the_best_earlier_mission_runs_whatever_the_space_begins_with(begins: int, initial: int) -> None:
    space = dataclasses.replace(
        synthetic.SPACE, begin=tuple({"gate.budget_fraction": k / 10} for k in range(begins))
    )
    earlier = EarlierMissions(space, synthetic.ROCKS, tuple(synthetic.random_design(40, 0.01, 0)))
    problem = dataclasses.replace(synthetic.PROBLEM, space=space)
    settings = dataclasses.replace(synthetic.sampler_settings(0, initial), problem=problem, earlier=earlier)
    sampler, history = make_sampler("gp", settings), synthetic.random_design(initial, 0.01, 0)
    first = next(p for n in range(initial) if "rank" in (p := sampler.ask(history[:n], [])).metadata)
    assert first.metadata["rank"] == 0 and first.values == earlier.best(1)[0]
