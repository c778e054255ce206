"""The samplers by name. A new one is a file with a class, and a line here.

Nothing is imported before a sampler is made: the command line lists their names.
"""

from __future__ import annotations

from collections.abc import Callable

from nbv.config.registry import Registry
from tuner.samplers.base import Sampler, SamplerSettings

# A class each, made of its settings and its name.
SAMPLERS = Registry(
    "sampler",
    {
        "gp": "tuner.samplers.gp:GPSampler",
        "sobol": "tuner.samplers.plain:SobolSampler",
        "random": "tuner.samplers.plain:RandomSampler",
        "tpe": "tuner.samplers.optuna:OptunaSampler",
        "optuna-gp": "tuner.samplers.optuna:OptunaSampler",
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
    make: Callable[[SamplerSettings, str], Sampler] = SAMPLERS.load(name)
    return make(settings, name)
