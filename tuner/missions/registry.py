"""Fidelities by name. A new one is one file, with a `tuner.missions.kinds.MissionKind`, and one line here.

The name goes into a campaign's settings, to the workers, and to ``--fidelity``. From Python and on the command line a
fidelity may also be ``"module:function"``. A file may not choose code: where one says so, the caller must have named it too.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
from collections.abc import Callable
from pathlib import Path

from nbv.cache import code_digest
from nbv.config.registry import Registry
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.missions.kinds import PHOTOGRAPHS as OVER_PHOTOGRAPHS
from tuner.missions.kinds import MissionKind

FIDELITIES = Registry(
    "fidelities",
    {
        "photogrammetric": "tuner.missions.kinds:PHOTOGRAMMETRIC",
        "geometric": "tuner.missions.kinds:GEOMETRIC",
        "curve": "tuner.missions.kinds:CURVE",
        "photographs": "tuner.missions.kinds:PHOTOGRAPHS",
        "external": "tuner.missions.kinds:EXTERNAL",
    },
)
DEFAULT_FIDELITY = "photogrammetric"
PHOTOGRAPHS = "photographs"
EXTERNAL = "external"  # runs the missions of mission files


def mission_kind(fidelity: str) -> MissionKind:
    """What is known of missions of this fidelity: nothing where it is a function, or no fidelity that there is now.

    Raises `UserError`: a plug-in that cannot be imported.
    """
    found = FIDELITIES.load(fidelity) if fidelity in FIDELITIES else fidelity
    return found if isinstance(found, MissionKind) else MissionKind(found)


def kind_on(target: str, fidelity: str) -> MissionKind:
    """What is known of missions of this fidelity on ``target``: over a set of photographs nothing is rendered nor simulated.

    Raises `UserError`: such missions cannot run on it; as `mission_kind`.
    """
    kind = mission_kind(fidelity)
    if kind.targets == "rocks" and OVER_PHOTOGRAPHS.flies(target):
        return OVER_PHOTOGRAPHS
    if not kind.flies(target):
        remedy = (
            "gatetune photographs import makes a set" if kind.targets == "photographs" else "name another"
        )
        raise UserError(f"{fidelity} missions cannot run on {target}; {remedy}")
    return kind


def require_fidelity(fidelity: str) -> None:
    """Raise `UserError` for a name that no fidelity has; ``"module:function"`` is not looked for here."""
    if ":" not in fidelity and fidelity not in FIDELITIES:
        raise UserError(f"unknown fidelity {fidelity!r}; choose from {', '.join(FIDELITIES)}")


def refuse_code_of_file(fidelity: str, named: str | None, source: str) -> None:
    """Raise `UserError` where the file ``source`` names a ``"module:function"`` that the caller has not ``named`` too."""
    if ":" in fidelity and fidelity != named:
        raise UserError(
            f"{source} asks to run code of its own, {fidelity!r}; if you trust it, name it: --fidelity {fidelity}"
        )


def modules_of(fidelity: str) -> tuple[str, ...]:
    """The modules that a worker imports to run ``fidelity``: its own, then libraries. Another's code is not imported for this."""
    if fidelity not in FIDELITIES.own:
        return (FIDELITIES.get(fidelity, fidelity).partition(":")[0],)
    kind = mission_kind(fidelity)
    return str(kind.runs).partition(":")[0], *kind.loads


@functools.cache
def code_of(fidelity: str) -> str:
    """Return the digest of a fidelity's code: a built-in one with all it imports of ``nbv``, another's own file alone."""
    if (plugin := FIDELITIES.plugin(fidelity)) is not None:
        return plugin.source
    module = modules_of(fidelity)[0]
    if module.partition(".")[0] == "nbv":
        return code_digest(module)
    try:
        found = importlib.util.find_spec(module)
        content = Path(found.origin).read_bytes() if found is not None and found.origin else b""
    except (ImportError, ValueError, OSError):  # each mission will meet it and say so
        content = b""
    return hashlib.sha256(content).hexdigest()[:32]


def mission_function(fidelity: str) -> Callable[..., MissionResult]:
    """The `nbv.mission.MissionFunction` behind a name or ``"module:function"``.

    Raises `UserError`: there is no such fidelity.
    """
    require_fidelity(fidelity)
    return mission_kind(fidelity).function
