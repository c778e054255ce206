"""A mission as a function of the tuned values, for an optimiser of one's own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from optuna.distributions import BaseDistribution

from nbv.errors import UserError
from tuner.campaign.ledger import distributions
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import resolved_settings
from tuner.missions.registry import kind_on
from tuner.problem.search_space import Parameter, Values


@dataclass(frozen=True)
class MissionObjective:
    """The mean of a metric over instances and replicates; missions run in this process, one after the other."""

    settings: CampaignSettings
    failed: float

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' paths, in the order of `bounds` and of a sequence of values."""
        return self.settings.space.paths

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """(low, high) of each parameter, both included, in its own unit; of a categorical one the indices of its choices."""
        return [
            (0.0, len(p.choices) - 1.0) if p.kind == "categorical" else (float(p.low), float(p.high))
            for p in self.settings.space.parameters
        ]

    @property
    def default(self) -> Values:
        """The paper's values by path."""
        return self.settings.problem.default

    def __call__(self, values: Mapping[str, Any] | Sequence[float]) -> float:
        """The metric in its own unit and direction.

        Parameters
        ----------
        values
            Values by path; what is left out has its default. Or (d,) numbers in the order of `names`: whole numbers are
            rounded, and a categorical parameter takes the index of its choice.

        Returns
        -------
        float
            ``failed`` where a mission fails.

        Raises
        ------
        UserError
            A path is not in the space, or a value is out of its range.
        """
        s, by_path = self.settings, self._by_path(values)
        measurements = list[float]()
        for instance in s.problem.instances:
            config = s.problem.config(by_path, instance.condition)
            for replicate in range(s.replicates):
                result = kind_on(instance.rock, s.fidelity)(config, instance.rock, replicate, None)
                measured = {**result.metrics, "costs": result.costs}
                value, _ = s.objective.value_or_reason(result.status, measured)
                if value is None:
                    return self.failed
                measurements.append(value)
        return sum(measurements) / len(measurements)

    def _by_path(self, values: Mapping[str, Any] | Sequence[float]) -> Values:
        if not isinstance(values, Mapping):
            if len(values) != len(self.names):
                raise UserError(
                    f"there are {len(self.names)} parameters ({', '.join(self.names)}), not {len(values)}"
                )
            values = {p.path: _value(p, float(x)) for p, x in zip(self.settings.space.parameters, values)}
        self.settings.space.require(values)
        return {**self.default, **values}

    def optuna_distributions(self) -> dict[str, BaseDistribution]:
        """Optuna's distributions by path, for ``study.ask``."""
        return distributions(self.settings.space)


def objective(
    space: str,
    rocks: Sequence[str],
    fidelity: str = "geometric",
    *,
    failed: float = math.nan,
    **settings: Any,
) -> MissionObjective:
    """Return missions on ``rocks`` as a function of the values of a search space.

    Parameters
    ----------
    space
        Name or file of a search space.
    rocks
        Catalogue names or mesh files.
    fidelity
        Such as ``geometric`` or ``photogrammetric``.
    failed
        What a failed mission counts as.
    settings
        Other settings of a campaign by name, such as ``objective`` (one metric), ``replicates``, ``conditions``, ``overrides``.

    Raises
    ------
    UserError
        A setting is wrong, or the objective has a limit.
    """
    fields = {
        "name": "objective",
        "space": space,
        "rocks": rocks if isinstance(rocks, str) else list(rocks),
        "fidelity": fidelity,
        **settings,
    }
    resolved = resolved_settings(fields, "objective()")
    if resolved.second is not None:
        raise UserError(
            f"objective() returns {resolved.objective.metric} and would not keep the limit on {resolved.second.metric}; make a "
            "function of each with two calls, and give the limit to your optimiser"
        )
    return MissionObjective(resolved, failed)


def _value(p: Parameter, x: float) -> Any:
    if p.kind == "float" or not math.isfinite(x):
        return x
    return p.choices[round(x)] if p.kind == "categorical" and 0 <= round(x) < len(p.choices) else round(x)
