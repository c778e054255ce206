"""The samplers by name. A new one is a file with a function that makes it, and a line here.

Nothing is imported before a sampler is made: the command line lists their names.
"""

from __future__ import annotations

from collections.abc import Callable

from nbv.config.registry import Registry
from tuner.samplers.base import Sampler, SamplerSettings

# A function each that makes a sampler of (name, settings).
SAMPLERS = Registry(
    "sampler",
    {
        "gp": "tuner.samplers.gp:make_gp_sampler",
        "sobol": "tuner.samplers.plain:make_plain_sampler",
        "random": "tuner.samplers.plain:make_plain_sampler",
        "tpe": "tuner.samplers.optuna:make_optuna_sampler",
        "optuna-gp": "tuner.samplers.optuna:make_optuna_sampler",
    },
)
SAMPLER_NAMES = tuple(SAMPLERS)


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """Return the sampler called ``name``.

    Raises
    ------
    UserError
        No such sampler, or one that cannot handle the search space.
    """
    make: Callable[[str, SamplerSettings], Sampler] = SAMPLERS.load(name)
    return make(name, settings)
