"""What a recommendation is made from: the missions of a campaign, and what the campaign asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tuner.acquisition.constrained import Constraint
from tuner.problem.deterministic_metrics import DeterministicMetric
from tuner.problem.instances import InstanceLike
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace
from tuner.surrogate.settings import SurrogateSettings


@dataclass(frozen=True)
class CampaignData:
    """The missions of a campaign, and what they were run on.

    With ``only_verified`` a configuration has to have run often enough to be recommended (`tuner.recommendation.choose`).
    Samplers that run nothing again leave no such configuration: theirs is any that has run.
    """

    space: SearchSpace
    observations: Sequence[Observation]  # finished missions; outcomes of `Goal.modelled`
    instances: Sequence[InstanceLike]  # training instances
    default: Mapping[str, Any]
    replicates: int = 1  # per instance
    only_verified: bool = True
    settings: SurrogateSettings | None = None  # of the surrogate; None: by the search space


@dataclass(frozen=True)
class Goal:
    """The objective, and the limit of a second one where there is one: only what keeps it may be recommended."""

    objective: Objective
    second: Objective | None = None
    limit: float | None = None  # of the second objective, in its unit
    constraint: Constraint | None = None  # that limit, with the model of what has it
    deterministic: DeterministicMetric | None = None  # the objective, where the configuration decides it

    @property
    def modelled(self) -> Objective:
        """The objective that has the surrogate: the second one where the configuration decides the first."""
        return self.second if self.deterministic is not None and self.second is not None else self.objective
