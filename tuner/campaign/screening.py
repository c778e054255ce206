"""Screening: a search with a low fidelity before the first expensive mission.

Geometric missions rank configurations about as well as a second photogrammetric replicate does
(docs/results/geometric_fidelity.md) and take a thirtieth of the time. So the same optimiser first looks for the best
configuration of the low fidelity; what it flew leads the campaign's initial design and informs its surrogate
(``tuner.samplers.earlier_missions``). All cheap missions come before the first expensive one, so that the last third of a budget is
full fidelity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import MissionFailure, UserError
from tuner.missions.job import MissionRunner
from tuner.problem.blocks import next_slot
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace, Values
from tuner.samplers.design import initial_design_size
from tuner.samplers.earlier_missions import EarlierMissions

# As many as were measured (docs/results/optimiser_comparison.md, "On photogrammetry"): 20 s of one core, asks included.
CHEAP_MISSIONS = 96
_REPLICATES = 2

# (configuration, rock, replicate) -> outcome, larger is better; None: failed
CheapMission = Callable[[Values, str, int], float | None]
# So many failures before anything has succeeded mean that this fidelity says nothing of this objective.
_HOPELESS = 8


class CheapMissions:
    """Flies the missions of a low fidelity for their outcome.

    Raises
    ------
    UserError
        Calling it, when the first missions have all failed, or none of them has the metric.
    """

    def __init__(
        self, runner: MissionRunner, config: Callable[[Values], MissionConfig], objective: Objective
    ) -> None:
        self._runner, self._config, self._objective = runner, config, objective
        self._failed = 0
        self._succeeded = False

    def __call__(self, values: Values, rock: str, replicate: int) -> float | None:
        """The outcome, larger is better; None: failed."""
        value, reason = None, "mission failed"
        try:
            result = self._runner(self._config(values), rock, replicate, None)
            value, reason = self._objective.outcome(result.status, result.metrics)
        except MissionFailure as failure:
            reason = str(failure)
        if value is not None:
            self._succeeded = True
            return self._objective.sign * value
        self._failed += 1
        if self._failed >= _HOPELESS and not self._succeeded:
            raise UserError(
                f"the first {self._failed} missions of the low fidelity failed, the last with {reason!r}; begin another "
                "campaign without the low fidelity, or for a metric that it has"
            )
        return None


def screen(
    space: SearchSpace,
    rocks: Sequence[str],
    default: Mapping[str, Any],
    fly: CheapMission,
    seed: int,
    on_mission: Callable[[int, int], None] = lambda done, total: None,
    *,
    trusted_default: bool = False,
    earlier: EarlierMissions | None = None,
) -> EarlierMissions:
    """Fly the cheap missions: ``CHEAP_MISSIONS`` of our own sampler's, from the default on.

    ``on_mission`` hears ``(flown, total)`` after each. ``trusted_default``: chosen by hand, so the design may stay near it;
    ``earlier``: missions flown before these.
    """
    from tuner.samplers.registry import GPSampler, SamplerSettings, derived_seed

    initial = initial_design_size(
        space.dimension, CHEAP_MISSIONS, trusted_default=trusted_default, earlier=earlier is not None
    )
    # Another seed than the campaign's: other Sobol points than those of its own initial design.
    sampler = GPSampler(
        SamplerSettings(
            space, dict(default), tuple(rocks), derived_seed(seed, CHEAP_MISSIONS), initial, _REPLICATES,
            budget=CHEAP_MISSIONS, trusted_default=trusted_default, earlier=earlier,
        )
    )  # fmt: skip
    history: list[Observation] = []
    while len(history) < CHEAP_MISSIONS:
        proposal = sampler.ask(history, [])
        rock, replicate = next_slot(rocks, _REPLICATES, history, proposal)
        y = fly(proposal.values, rock, replicate)
        history.append(
            Observation(len(history), proposal.values, rock, replicate, y, y, memory=proposal.memory)
        )
        on_mission(len(history), CHEAP_MISSIONS)
    return EarlierMissions(space, tuple(rocks), tuple(history))
