"""Verification missions: the favourite flown again when that is worth more than exploring."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import synthetic

from tuner.problem.observations import Observation, Pending
from tuner.problem.search_space import Values
from tuner.samplers.gp import GPSampler
from tuner.samplers.verification import verification
from tuner.surrogate.model import RockMeanGP

ROCKS = ("r0", "r1", "r2")
GOOD, FAIR = synthetic.SPACE.from_unit([0.7, 0.3]), synthetic.SPACE.from_unit([0.2, 0.8])


def seen(
    number: int, values: Values, rock: str, outcome: float | None, replicate: int = 0, **sampler_state: Any
) -> Observation:
    return Observation(number, values, rock, replicate, outcome, outcome, sampler_state=sampler_state)


def a_clear_favourite() -> list[Observation]:
    """GOOD has flown r0 only; FAIR, ten points worse, has flown everywhere."""
    history = [seen(i, FAIR, rock, 50.0 + 0.1 * i) for i, rock in enumerate(ROCKS)]
    return [*history, seen(3, GOOD, "r0", 60.0)]


def model_of(history: list[Observation]) -> RockMeanGP:
    return RockMeanGP(synthetic.SPACE, history, ROCKS)


def test_favourite_flies_every_block_it_has_not_seen() -> None:
    history = a_clear_favourite()
    proposal = verification(model_of(history), history, [], 2, expected_gain=0.0)
    assert proposal is not None and proposal.values == GOOD and proposal.why["phase"] == "verification"
    assert (proposal.rock, proposal.replicate) == ("r1", 1)  # replicate 0 of r1 has been flown once, 1 never
    blocks = [("r0", 0)]
    flying: list[Pending] = []
    while (proposal := verification(model_of(history), history, flying, 2, expected_gain=0.0)) is not None:
        blocks.append((proposal.rock or "", -1 if proposal.replicate is None else proposal.replicate))
        flying.append(Pending(4 + len(flying), GOOD, *blocks[-1]))
    assert {rock for rock, _ in blocks[:3]} == set(ROCKS), "every rock once comes before any rock twice"
    assert sorted(blocks) == [(rock, k) for rock in ROCKS for k in range(2)]


def test_nothing_to_verify_while_exploring_promises_more() -> None:
    history = a_clear_favourite()
    model = model_of(history)
    assert verification(model, history, [], 1, expected_gain=10 * model.noise_sd) is None
    assert verification(model, history, [], 1, expected_gain=10 * model.noise_sd, last=True) is not None
    assert verification(model, history, [], 1, expected_gain=0.5 * model.noise_sd) is not None


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
            seen(i, p.values, p.rock or synthetic.ROCKS[i % 4], value, p.replicate or 0, **p.sampler_state)
        )
        phases.append(p.why["phase"])
    return history, phases


@pytest.mark.slow
@pytest.mark.parametrize("verify", [True, False])
def test_sampler_verifies_at_its_budget_s_end_on_a_plateau(verify: bool) -> None:
    settings = dataclasses.replace(synthetic.sampler_settings(0, 4), budget=12, replicates=2)
    # A cliff; nothing to gain elsewhere.
    _, phases = campaign(
        GPSampler(settings, verify=verify), 12, lambda x: 40.0 if x[0] < 0.3 else 60.0, seed=0
    )
    assert "verification" not in phases[:8]
    assert ("verification" in phases[8:]) == verify
