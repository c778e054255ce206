"""The samplers by name. A new one is a file with a function that makes it, and a line here.

Nothing is imported before a sampler is made: the command line lists their names.
"""

from __future__ import annotations

from collections.abc import Callable

from nbv.config.registry import Registry
from tuner.samplers.base import Sampler, SamplerSettings
from tuner.samplers.peers import PEER_NAMES, make_peer_sampler, peer_command

# A function each that makes a sampler of (name, settings).
SAMPLERS = Registry(
    "sampler",
    {
        "gp": "tuner.samplers.gp:make_gp_sampler",
        "sobol": "tuner.samplers.plain:make_plain_sampler",
        "random": "tuner.samplers.plain:make_plain_sampler",
        "tpe": "tuner.samplers.optuna:make_optuna_sampler",
        "cmaes": "tuner.samplers.optuna:make_optuna_sampler",
        "optuna-gp": "tuner.samplers.optuna:make_optuna_sampler",
    },
)
SAMPLER_NAMES = tuple(SAMPLERS)  # these are always there
ALL_SAMPLER_NAMES = (*SAMPLER_NAMES, *PEER_NAMES)


def require_sampler(name: str) -> None:
    """Check that what sampler ``name`` needs is installed.

    Raises
    ------
    UserError
        The environment of a peer has not been set up.
    """
    if name in PEER_NAMES:
        peer_command(name)


def make_sampler(name: str, settings: SamplerSettings) -> Sampler:
    """The sampler called ``name``.

    Raises
    ------
    UserError
        No such sampler, or one that cannot handle the search space.
    """
    if name in PEER_NAMES:
        return make_peer_sampler(name, settings)
    make: Callable[[str, SamplerSettings], Sampler] = SAMPLERS.load(name)
    return make(name, settings)
