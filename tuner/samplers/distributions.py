"""A search space as Optuna's samplers, importances and storages know it."""

from __future__ import annotations

from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from tuner.problem.search_space import Parameter, SearchSpace


def distributions(space: SearchSpace) -> dict[str, BaseDistribution]:
    """Return Optuna distributions by path, of the same sets as the parameters."""
    return {parameter.path: _distribution(parameter) for parameter in space.parameters}


def _distribution(parameter: Parameter) -> BaseDistribution:
    if parameter.kind == "categorical":
        return CategoricalDistribution(parameter.choices)
    log = parameter.scale == "log"
    if parameter.kind == "int":
        return IntDistribution(int(parameter.low), int(parameter.high), log=log)
    return FloatDistribution(parameter.low, parameter.high, log=log)
