"""The samplers by name. A new one is a file with a function that makes it, and a line here.

Nothing is imported before a sampler is made: the command line lists their names.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

from nbv.errors import UserError
from tuner.samplers.base import Sampler, SamplerSettings
from tuner.samplers.peers import PEER_NAMES, make_peer_sampler, peer_command

_MODULES = {
    "gp": "gp:make_gp_sampler",
    "sobol": "plain:make_plain_sampler",
    "random": "plain:make_plain_sampler",
    "tpe": "optuna:make_optuna_sampler",
    "cmaes": "optuna:make_optuna_sampler",
    "optuna-gp": "optuna:make_optuna_sampler",
}
SAMPLER_NAMES = tuple(_MODULES)  # these are always there
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
    if name not in _MODULES:
        raise UserError(f"unknown sampler {name!r}; there are {', '.join(ALL_SAMPLER_NAMES)}")
    module, _, function = _MODULES[name].partition(":")
    make: Callable[[str, SamplerSettings], Sampler] = getattr(
        importlib.import_module(f"tuner.samplers.{module}"), function
    )
    return make(name, settings)
