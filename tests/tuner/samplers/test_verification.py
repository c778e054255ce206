import dataclasses
import math

import synthetic

from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.search_space import TUNED, Region, Values
from tuner.samplers import gp
from tuner.samplers.base import SamplerSettings
from tuner.samplers.gp import verification
from tuner.surrogate.model import InstanceMeanGP

ROCKS = ("r0", "r1", "r2")
EVERYWHERE = Region(TUNED, synthetic.SPACE)
GOOD, FAIR = synthetic.SPACE.from_unit([0.7, 0.3]), synthetic.SPACE.from_unit([0.2, 0.8])


def seen(number: int, values: Values, rock: str, outcome: float | None, replicate: int = 0) -> Observation:
    return Observation(number, values, rock, replicate, outcome, outcome)


def a_clear_favourite() -> list[Observation]:
    """GOOD has run r0 only; FAIR, ten points worse, has run everywhere."""
    history = [seen(i, FAIR, rock, 50.0 + 0.1 * i) for i, rock in enumerate(ROCKS)]
    return [*history, seen(3, GOOD, "r0", 60.0)]


def model_of(history: list[Observation]) -> InstanceMeanGP:
    return InstanceMeanGP(synthetic.SPACE, history, tuple(map(Instance, ROCKS)))


def test_favourite_flies_every_block_it_has_not_seen() -> None:
    history = a_clear_favourite()
    proposal = verification(model_of(history), EVERYWHERE, history, [], 2, expected_gain=0.0)
    assert proposal is not None and proposal.values == GOOD and proposal.metadata["phase"] == "verification"
    # Replicate 0 of r1 has been run once, 1 never.
    assert (proposal.instance, proposal.replicate) == (("r1", "ideal"), 1)
    blocks = [("r0", 0)]
    running: list[Observation] = []
    while (
        proposal := verification(model_of(history), EVERYWHERE, history, running, 2, expected_gain=0.0)
    ) is not None:
        blocks.append((proposal.instance.rock, proposal.replicate))
        running.append(Observation(4 + len(running), GOOD, *blocks[-1]))
    assert {rock for rock, _ in blocks[:3]} == set(ROCKS), "every rock once comes before any rock twice"
    assert sorted(blocks) == [(rock, k) for rock in ROCKS for k in range(2)]


def test_among_drawn_rocks_only_the_last_missions_are_the_favourites_in_any_case(monkeypatch) -> None:
    """Every mission meets a rock of its own, so that a family has as many replicates as the budget has missions."""
    asked: list[bool] = []
    monkeypatch.setattr(gp, "verification", lambda *arguments, last, **options: asked.append(last))
    family = dataclasses.replace(synthetic.PROBLEM, instances=(Instance("any-cleft"),), replicates=18)
    s = SamplerSettings(family, 0, 4, budget=18)
    for evaluated in (11, 12, 15, 16, 17):
        drawn = synthetic.random_design(evaluated, 0.1, 0)
        history = [seen(i, o.values, "any-cleft", o.outcome, i) for i, o in enumerate(drawn)]
        gp.GPSampler(s).ask(history, [])
    assert asked == [True, True]


def test_nothing_to_verify_while_exploring_promises_more() -> None:
    history = a_clear_favourite()
    model = model_of(history)
    assert verification(model, EVERYWHERE, history, [], 1, expected_gain=10 * model.noise_sd) is None
    assert (
        verification(model, EVERYWHERE, history, [], 1, expected_gain=10 * model.noise_sd, last=True)
        is not None
    )
    assert verification(model, EVERYWHERE, history, [], 1, expected_gain=0.5 * model.noise_sd) is not None
    drawn = verification(model, EVERYWHERE, history, [], 1, expected_gain=math.inf, last=True)
    assert drawn is not None and "expected_gain" not in drawn.metadata
