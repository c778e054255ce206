"""Samplers by name. A new one is a file with a class, and a line here; none is imported before it is made."""

from __future__ import annotations

from nbv.plugins import Registry
from tuner.samplers.base import Sampler, SamplerSettings

# A class each, made of its settings and its name.
BUILT_IN = {
    "gp": "tuner.samplers.gp:GPSampler",
    "sobol": "tuner.samplers.base:PlainSampler",
    "random": "tuner.samplers.base:PlainSampler",
}
SAMPLERS = Registry("samplers", BUILT_IN)


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """Return the sampler called ``name``.

    Raises `UserError`: no such sampler, or one (of a plug-in) that cannot handle the search space.
    """
    sampler: Sampler = SAMPLERS.load(name, BUILT_IN)(settings, name)
    return sampler
