"""Missions run before a campaign, elsewhere: on other rocks or with a cheaper fidelity (``tuner.campaign.begin``).

Their best configurations, by a surrogate of those missions, take places of the campaign's initial design. The campaign's own
surrogate knows its own missions only: the landscape of the earlier ones as a feature of it gained nothing
(docs/results/index.md).
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nbv.config import IDEAL
from nbv.safe_files import parse_json
from nbv.types import Floats
from tuner.problem.instances import conditions_of, instances_over
from tuner.problem.observations import Observation, distinct_configurations
from tuner.problem.search_space import SearchSpace, Values

if TYPE_CHECKING:
    from tuner.surrogate.model import InstanceMeanGP

# Root mean square distance in the unit cube between their configurations in an initial design.
_APART = 0.15


@dataclass(frozen=True)
class EarlierMissions:
    """Missions run before a campaign, which its sampler learns from; some of them succeeded."""

    space: SearchSpace
    rocks: tuple[str, ...]
    observations: tuple[Observation, ...]
    # Besides: rocks drawn of families, and those that their campaigns learned from.
    seen: frozenset[str] = frozenset()

    @functools.cached_property
    def _model(self) -> InstanceMeanGP:
        from tuner.surrogate.model import InstanceMeanGP  # noqa: PLC0415  a campaign is looked at without torch

        instances = instances_over(self.rocks, conditions_of(o.instance for o in self.observations))
        return InstanceMeanGP(self.space, self.observations, instances)

    def best(self, count: int) -> list[Values]:
        """Return the configurations run with the best posterior means that are apart from each other; at most ``count``."""
        gp = self._model
        seen = distinct_configurations(self.space, gp.observations)
        chosen: list[tuple[Values, Floats]] = []
        for index in np.argsort(-gp.posterior(seen).mean, kind="stable"):
            unit = self.space.to_unit(seen[index])
            if all(np.sqrt(np.mean((unit - other) ** 2)) > _APART for _, other in chosen):
                chosen.append((seen[index], unit))
            if len(chosen) == count:
                break
        return [values for values, _ in chosen]

    def to_json(self) -> str:
        """Return the text of a file beside the ledger."""
        rows = [
            [dict(o.values), o.rock, o.outcome, o.replicate, *([o.condition] if o.condition != IDEAL else [])]
            for o in self.observations
        ]
        return json.dumps({"rocks": list(self.rocks), "missions": rows, "seen": sorted(self.seen)})

    @staticmethod
    def from_json(text: str, space: SearchSpace) -> EarlierMissions:
        """Return the inverse of ``to_json``; ``UserError``, ``ValueError``, ``TypeError`` or ``KeyError`` where it is not."""
        tree = parse_json(text, "the missions learned from")
        observations = [
            Observation(i, v, r, k, y, y, condition=condition[0] if condition else IDEAL)
            for i, (v, r, y, k, *condition) in enumerate(tree["missions"])
        ]
        seen = frozenset(tree.get("seen", ()))  # files of earlier versions have none
        return EarlierMissions(space, tuple(tree["rocks"]), tuple(observations), seen)
