"""Verification missions: flown when they are worth more than exploring, and counted in the recommendation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import synthetic

from nbv.errors import UserError
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation, Pending
from tuner.problem.search_space import Values
from tuner.recommendation.recommendation import recommend
from tuner.samplers.gp import GPSampler
from tuner.samplers.verification import PREDICTED, expected_shortfall, markdown, verification
from tuner.surrogate.model import RockMeanGP

ROCKS = ("r0", "r1", "r2")
GOOD, FAIR = synthetic.SPACE.from_unit([0.7, 0.3]), synthetic.SPACE.from_unit([0.2, 0.8])


def seen(
    number: int, values: Values, rock: str, outcome: float | None, replicate: int = 0, **memory: Any
) -> Observation:
    return Observation(number, values, rock, replicate, outcome, outcome, memory=memory)


def a_clear_favourite() -> list[Observation]:
    """GOOD has flown r0 only; FAIR, ten points worse, has flown everywhere."""
    history = [seen(i, FAIR, rock, 50.0 + 0.1 * i) for i, rock in enumerate(ROCKS)]
    return [*history, seen(3, GOOD, "r0", 60.0)]


def model_of(history: list[Observation]) -> RockMeanGP:
    return RockMeanGP(synthetic.SPACE, history, ROCKS)


def test_shortfall_is_the_mean_gap_with_one_made_up_mission() -> None:
    history = [seen(0, GOOD, "r0", 60.0), seen(1, GOOD, "r1", 57.0, **{PREDICTED: 60.0}),
               seen(2, GOOD, "r2", 61.0, **{PREDICTED: 60.0}), seen(3, GOOD, "r2", None, 1, **{PREDICTED: 60.0})]  # fmt: skip
    assert expected_shortfall(history, 0.4) == pytest.approx((0.4 + 3.0 - 1.0) / 3)
    assert expected_shortfall(history[:1], 0.4) is None
    better = [seen(0, GOOD, "r1", 70.0, **{PREDICTED: 60.0})]
    assert expected_shortfall(better, 0.4) == 0.0


@pytest.mark.parametrize("value", ["high", None, float("nan")])
def test_prediction_that_is_no_number_is_one_line(value: object) -> None:
    with pytest.raises(UserError, match="predicted for trial 7, which is no number; restore the ledger"):
        expected_shortfall([seen(7, GOOD, "r1", 57.0, **{PREDICTED: value})], 0.4)


def test_favourite_flies_every_slot_it_has_not_seen() -> None:
    history = a_clear_favourite()
    proposal = verification(model_of(history), history, [], 2, expected_gain=0.0)
    assert proposal is not None and proposal.values == GOOD and proposal.why["phase"] == "verification"
    assert (proposal.rock, proposal.replicate) == ("r1", 1)  # replicate 0 of r1 has been flown once, 1 never
    assert proposal.memory[PREDICTED] == pytest.approx(proposal.why["predicted_mean"])
    blocks = [("r0", 0)]
    flying: list[Pending] = []
    while (proposal := verification(model_of(history), history, flying, 2, expected_gain=0.0)) is not None:
        blocks.append((proposal.rock or "", -1 if proposal.replicate is None else proposal.replicate))
        assert (PREDICTED in proposal.memory) == (len(blocks) == 2), "only the first check tells of the model"
        flying.append(Pending(4 + len(flying), GOOD, *blocks[-1]))
    assert {rock for rock, _ in blocks[:3]} == set(ROCKS), "every rock once comes before any rock twice"
    assert sorted(blocks) == [(rock, k) for rock in ROCKS for k in range(2)]


def test_nothing_to_verify_while_exploring_promises_more() -> None:
    history = a_clear_favourite()
    model = model_of(history)
    assert verification(model, history, [], 1, expected_gain=10 * model.noise_sd) is None
    assert verification(model, history, [], 1, expected_gain=10 * model.noise_sd, last=True) is not None
    # Where such missions fell far short before, the same promise is not enough.
    history[1] = dataclasses.replace(history[1], memory={PREDICTED: history[1].outcome + 50 * model.noise_sd})
    assert verification(model, history, [], 1, expected_gain=10 * model.noise_sd) is not None


def test_last_missions_complete_what_would_be_recommended() -> None:
    """GOOD promises a little more than FAIR, but the favourites before it fell short by much more than that."""
    history = [seen(0, FAIR, "r0", 50.0), seen(1, FAIR, "r1", 50.1), seen(2, FAIR, "r2", 50.0),
               seen(3, FAIR, "r2", 50.1, 1, **{PREDICTED: 60.0}), seen(4, GOOD, "r0", 52.0)]  # fmt: skip
    model = model_of(history)
    early = verification(model, history, [], 2, expected_gain=0.0)
    assert early is not None and early.values == GOOD
    late = verification(model, history, [], 2, expected_gain=0.0, last=True)
    assert late is not None and late.values == FAIR and late.replicate == 1 and late.rock in ("r0", "r1")
    complete = [*history, seen(5, FAIR, "r0", 50.0, 1), seen(6, FAIR, "r1", 50.0, 1)]
    then = verification(model_of(complete), complete, [], 2, expected_gain=0.0, last=True)
    assert then is not None and then.values == GOOD, "what is complete leaves the missions to the favourite"


def test_marked_down_for_the_share_of_slots_not_flown() -> None:
    history = a_clear_favourite()
    space = synthetic.SPACE
    np.testing.assert_allclose(markdown(space, history, [FAIR, GOOD], ROCKS, 1.5), [0.0, 1.0])
    history.append(seen(4, FAIR, "r0", 50.0, 1))  # a fourth block, which GOOD has not flown either
    np.testing.assert_allclose(markdown(space, history, [FAIR, GOOD], ROCKS, 1.0), [0.0, 0.75])
    np.testing.assert_allclose(markdown(space, history, [FAIR, GOOD], ("r0",), 1.0), [0.0, 0.5])
    np.testing.assert_array_equal(markdown(space, history, [FAIR, GOOD], ROCKS, None), [0.0, 0.0])
    np.testing.assert_array_equal(markdown(space, history, [FAIR, GOOD], ROCKS, 1.0, GOOD), [0.0, 0.0])


def test_recommendation_counts_what_verification_found() -> None:
    """A lead that is smaller than what favourites fell short by so far is not believed; a larger one is."""

    def recommended(lead: float, counted: bool = True, default: Values = FAIR) -> tuple[Values, float | None]:
        rng = np.random.default_rng(0)
        history = [seen(i, FAIR, rock, 50.0 + 0.05 * rng.normal()) for i, rock in enumerate(ROCKS * 2)]
        other = synthetic.SPACE.from_unit([0.95, 0.05])
        history += [seen(6, other, "r0", 51.0), seen(7, other, "r1", 47.0, **{PREDICTED: 51.0})]
        history += [seen(8, GOOD, "r2", 50.0 + lead)]
        if not counted:
            history = [dataclasses.replace(o, memory={}) for o in history]
        result = recommend(synthetic.SPACE, history, ROCKS, default, Objective())
        assert result is not None
        return result.values, result.expected_shortfall

    small, shortfall = recommended(1.5)
    assert shortfall is not None and shortfall > 1.0
    assert small == FAIR
    assert recommended(1.5, counted=False)[0] == GOOD
    assert recommended(20.0)[0] == GOOD
    # The default was no favourite: nothing believed to be worse is recommended in its place.
    assert recommended(1.5, default=GOOD)[0] == GOOD


def campaign(
    sampler: GPSampler, missions: int, outcome: Callable[[np.ndarray], float], seed: int
) -> tuple[list[Observation], list[str]]:
    """The observations and phases of a campaign on synthetic rocks in turn; ``outcome`` of a position, without noise."""
    rng = np.random.default_rng(seed)
    history: list[Observation] = []
    phases: list[str] = []
    for i in range(missions):
        p = sampler.ask(history, [])
        value = outcome(synthetic.SPACE.to_unit(p.values)) + 0.1 * rng.normal()
        history.append(
            seen(i, p.values, p.rock or synthetic.ROCKS[i % 4], value, p.replicate or 0, **p.memory)
        )
        phases.append(p.why["phase"])
    return history, phases


@pytest.mark.parametrize("verify", [True, False])
def test_sampler_verifies_near_the_end_of_its_budget_on_a_plateau(verify: bool) -> None:
    settings = dataclasses.replace(synthetic.sampler_settings(0, 4), budget=12, replicates=2)
    # A cliff; nothing to gain elsewhere.
    _, phases = campaign(
        GPSampler(settings, verify=verify), 12, lambda x: 40.0 if x[0] < 0.3 else 60.0, seed=0
    )
    assert "verification" not in phases[:8]
    assert ("verification" in phases[8:]) == verify


def test_last_missions_are_the_favourites() -> None:
    """Wherever exploring promises something to the end, as many missions as there are blocks check the favourite."""
    settings = dataclasses.replace(synthetic.sampler_settings(0, 4), budget=20, replicates=2)
    history, phases = campaign(GPSampler(settings), 20, lambda x: 50.0 + 10.0 * float(x.sum()), seed=1)
    assert phases[12:].count("verification") >= 6
    best = recommend(synthetic.SPACE, history, synthetic.ROCKS, synthetic.DEFAULT, Objective())
    assert best is not None and sum(o.values == best.values for o in history) >= 4
