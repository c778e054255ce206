"""What a recommendation is made from: the missions of a campaign, and what the campaign asks for."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tuner.problem.deterministic_metrics import DeterministicMetrics, with_second_first
from tuner.problem.instances import InstanceLike
from tuner.problem.objective import Objective, least_outcome
from tuner.problem.observations import Observation
from tuner.problem.search_space import SearchSpace, Values
from tuner.surrogate.settings import SurrogateSettings


@dataclass(frozen=True)
class CampaignData:
    """The missions of a campaign, and what they were run on.

    With ``only_verified`` a configuration has to have run often enough to be recommended (`tuner.recommendation.choose`).
    Samplers that run nothing again leave no such configuration: theirs is any that has run.
    """

    space: SearchSpace
    observations: Sequence[Observation]  # finished missions
    instances: Sequence[InstanceLike]  # training instances
    default: Mapping[str, Any]
    replicates: int = 1  # per instance
    only_verified: bool = True
    settings: SurrogateSettings | None = None  # of the surrogate; None: by the search space
    repeatable: Collection[
        InstanceLike
    ] = ()  # instances on which a mission repeats exactly: no outlier there
    arms: Mapping[str, Values] = field(
        default_factory=dict
    )  # the plain plans by strategy, the simplest first


@dataclass(frozen=True)
class Goal:
    """The objective, and the limit of a second one where there is one: only what keeps it may be recommended.

    Which of the two has the surrogate is decided here: the second one where the configuration decides the first.
    """

    objective: Objective
    second: Objective | None = None
    limit: float | None = None  # of the second objective, in its unit
    exact: DeterministicMetrics = field(
        default_factory=DeterministicMetrics
    )  # what the configuration decides

    def after(self, history: Sequence[Observation]) -> Goal:
        """Return the goal after these missions, which may show that a metric is not deterministic after all."""
        return replace(self, exact=self.exact.confirmed_by(history))

    @property
    def _second_is_modelled(self) -> bool:
        return self.exact.first is not None and self.second is not None

    @property
    def modelled(self) -> Objective:
        """The objective that has the surrogate."""
        return self.second if self.second is not None and self._second_is_modelled else self.objective

    def outcomes(self, history: Sequence[Observation]) -> list[Observation]:
        """Return the missions whose outcomes are those of `modelled`."""
        return with_second_first(history) if self._second_is_modelled else list(history)

    @property
    def at_least(self) -> float | None:
        """The limit as an outcome of the second objective, larger is better."""
        return None if self.second is None or self.limit is None else least_outcome(self.second, self.limit)
