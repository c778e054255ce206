"""Fidelities by name. A new one is one file, with a `tuner.missions.kinds.MissionKind`, and one line here.

The name goes into a campaign's settings, to the workers, and to ``--fidelity``. Those of other packages are plug-ins, so that no
file of settings chooses code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from nbv.cache import code_digest
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.plugins import Registry
from tuner.missions.kinds import CURVE, GEOMETRIC, PHOTOGRAMMETRIC, MissionKind
from tuner.missions.kinds import EXTERNAL as OF_A_FILE
from tuner.missions.kinds import PHOTOGRAPHS as OVER_PHOTOGRAPHS

DEFAULT_FIDELITY = "photogrammetric"
PHOTOGRAPHS = "photographs"
EXTERNAL = "external"  # runs the missions of mission files
BUILT_IN = {
    DEFAULT_FIDELITY: PHOTOGRAMMETRIC,
    "geometric": GEOMETRIC,
    "curve": CURVE,
    PHOTOGRAPHS: OVER_PHOTOGRAPHS,
    EXTERNAL: OF_A_FILE,
}
FIDELITIES = Registry("fidelities", BUILT_IN)


def mission_kind(fidelity: str) -> MissionKind:
    """What is known of missions of this fidelity: nothing where it is a function, or no fidelity that there is now.

    Raises `UserError`: a plug-in that cannot be imported.
    """
    part = FIDELITIES.load(fidelity, BUILT_IN) if fidelity in FIDELITIES else ""
    return part if isinstance(part, MissionKind) else MissionKind(part)


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


def modules_of(fidelity: str) -> tuple[str, ...]:
    """The modules that a worker imports to run ``fidelity``: its own, then libraries. Another's code is not imported for this."""
    if (plugin := FIDELITIES.plugin(fidelity)) is not None:
        return (plugin.module,)
    kind = BUILT_IN[fidelity]
    return str(kind.runs).partition(":")[0], *kind.loads


def code_of(fidelity: str) -> str:
    """Digest of a fidelity's code: of ``nbv`` with all that it imports, of the adapter of mission files itself, of a plug-in its files."""
    if (plugin := FIDELITIES.plugin(fidelity)) is not None:
        return plugin.source
    if fidelity == EXTERNAL:
        adapter = Path(__file__).parent / "external" / "mission.py"
        return hashlib.sha256(adapter.read_bytes()).hexdigest()[:32]
    return code_digest(modules_of(fidelity)[0])


def mission_function(fidelity: str) -> Callable[..., MissionResult]:
    """The `nbv.mission.MissionFunction` of that name; ``UserError`` where there is none."""
    FIDELITIES.require(fidelity)
    return mission_kind(fidelity).function
