"""Fidelities by name. A new one is one file, with a function like `nbv.mission.MissionFunction`, and one line here.

The name goes into a campaign's settings, to the workers, and to ``--fidelity``. From Python and on the command line a
fidelity may also be ``"module:function"``. A file may not choose code: where one says so, the caller must have named it too.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import pkgutil
from collections.abc import Callable
from pathlib import Path

from nbv.cache import code_digest
from nbv.config.registry import Registry
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.rocks.catalogue import is_photographed

# Named by module, so that a command imports only what it runs.
FIDELITIES = Registry(
    "fidelities",
    {
        "photogrammetric": "nbv.photogrammetric:run_photogrammetric_mission",
        "geometric": "nbv.geometric:run_geometric_mission",
        "curve": "nbv.geometric.curve:run_curve_mission",
        "photographs": "nbv.photographs.mission:run_photographs_mission",
        "external": "tuner.missions.external.mission:run_external_mission",
    },
)
DEFAULT_FIDELITY = "photogrammetric"
# What their missions import when they need it, and a server before it forks, lest every mission does.
IMPORTED_IN_FLIGHT = {
    "nbv.photogrammetric": ("open3d", "torch"),
    "nbv.photographs.mission": ("open3d",),
    "nbv.geometric": ("open3d",),
    "nbv.geometric.curve": ("open3d",),
}
PHOTOGRAPHS = "photographs"
EXTERNAL = "external"  # runs the missions of mission files

LOW_FIDELITY_NOTE = (
    "Geometric missions are a low-fidelity simulation: the loop, scorers, gates and flight are the same, feature tracks are "
    "simulated, and no photograph is rendered. Completeness is predicted, accuracy is set to 100 %, and distances are not "
    "computed. Parameters of features, matching and the ground-truth gate have no effect, nor have conditions of sensor, telemetry, "
    "target and relief, nor of the scene but for its sun and match_angle_deg."
)


def is_geometric(name: str) -> bool:
    """Whether missions of this fidelity are geometric ones."""
    return name in ("geometric", "curve")


def runs_on_rocks(fidelity: str) -> bool:
    """Whether missions of this fidelity take the catalogue's rocks; what others call a rock is their own business."""
    return fidelity in FIDELITIES.own and fidelity != EXTERNAL


def fidelity_on(rock: str, fidelity: str) -> str:
    """The fidelity of a mission on ``rock``: over a set of photographs nothing is rendered nor simulated."""
    if runs_on_rocks(fidelity) and is_photographed(rock):
        return PHOTOGRAPHS
    if fidelity == PHOTOGRAPHS:
        raise UserError(f"{rock} is no set of photographs; gatetune photographs import makes one")
    return fidelity


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


def module_of(fidelity: str) -> str:
    """The module that a worker imports to run ``fidelity``."""
    return FIDELITIES.get(fidelity, fidelity).partition(":")[0]


@functools.cache
def code_of(fidelity: str) -> str:
    """Return the digest of a fidelity's code: a built-in one with all it imports of ``nbv``, another's own file alone."""
    if (plugin := FIDELITIES.plugin(fidelity)) is not None:
        return plugin.source
    module = module_of(fidelity)
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
    if fidelity in FIDELITIES:
        known: Callable[..., MissionResult] = FIDELITIES.load(fidelity)
        return known
    try:
        target = pkgutil.resolve_name(fidelity)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(
            f"fidelity {fidelity!r} cannot be imported ({error}); name it module:function"
        ) from error
    if not callable(target):
        raise UserError(f"fidelity {fidelity!r} is not a function; name it module:function")
    found: Callable[..., MissionResult] = target
    return found
