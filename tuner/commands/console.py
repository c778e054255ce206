"""The two rich consoles and small formatting helpers that commands share."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console

from nbv.config import IDEAL, PRESETS, Condition, MissionConfig, load_condition, preset, under
from nbv.errors import UserError
from nbv.foreign import parse_yaml

if TYPE_CHECKING:
    from tuner.missions.cluster.executor import DaskExecutor
    from tuner.missions.executors import LocalProcessExecutor
    from tuner.missions.external import MissionFile

# Names of rocks, campaigns and files may look like markup: it is read only where ``markup=True`` says so.
output = Console(markup=False, emoji=False)
errors = Console(stderr=True, markup=False, emoji=False)
_SCORING_S = 900.0
PRESET_NAMES = ", ".join(PRESETS)  # help of --preset
CONDITION_HELP = "World to fly in: a name of conditions/, or a YAML file."


Spoken = Literal["all", "quiet", "json"]
QUIET_HELP = "Only the verdict and where the report is."
JSON_HELP = "One JSON object per event, and nothing else."
_SLOW_S = 1.5
_spoken: list[Spoken] = ["all"]


def speak(how: Spoken) -> None:
    """What commands print from here on; every command begins with "all"."""
    _spoken[0] = how
    output.quiet = how != "all"


def spoken() -> Spoken:
    """As `speak` set it."""
    return _spoken[0]


@contextlib.contextmanager
def said_if_slow(text: str) -> Iterator[None]:
    """Print ``text`` where what is inside takes longer than a moment."""
    timer = threading.Timer(_SLOW_S, output.print, (text,))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def parse_overrides(assignments: list[str]) -> dict[str, Any]:
    """``["stop.adaptive_budget=4"]`` as ``{"stop.adaptive_budget": 4}``; values are YAML.

    Raises
    ------
    UserError
        An assignment without ``=`` or with an unreadable value.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        path, separator, text = assignment.partition("=")
        if not separator or not path.strip():
            raise UserError(
                f"--set {assignment!r} must be PATH=VALUE, for example --set stop.adaptive_budget=4"
            )
        values[path.strip()] = parse_yaml(text, f"--set {assignment!r}")
    return values


def mission_config(
    preset_name: str, assignments: list[str], gate: str | None = None, condition: str = IDEAL
) -> MissionConfig:
    """The preset under the condition, with ``--gate`` and ``--set`` applied."""
    values = parse_overrides(assignments)
    if gate is not None:
        values["gate.kind"] = gate
    return under(preset(preset_name), load_condition(condition)).with_values(best_dense_stage(values))


def best_dense_stage(values: Mapping[str, Any]) -> dict[str, Any]:
    """``values`` with COLMAP's PatchMatch, the paper's, where this machine can run it and they name no other.

    It becomes part of the configuration, so that a result says what made it, and a resume elsewhere uses the same.
    """
    from nbv.dense import patchmatch_runs

    if "dense.backend" in values or not patchmatch_runs():
        return dict(values)
    output.print(
        "dense stage: COLMAP's PatchMatch, since this machine has CUDA (--set dense.backend=sgbm for the CPU's)"
    )
    return {**values, "dense.backend": "patchmatch"}


def under_conditions(conditions: Sequence[Condition]) -> str:
    """``" under field, harsh"``; nothing under ``ideal`` alone."""
    names = [condition.name for condition in conditions]
    return "" if names == [IDEAL] else f" under {', '.join(names)}"


def rock_arguments(rocks: list[str]) -> list[str]:
    """Rocks as given, mesh files by their absolute path, so that a resume finds them from anywhere.

    Every rock is loaded once, so that a mistake shows before the first flight.

    Raises
    ------
    UserError
        An unknown rock or a bad mesh.
    """
    from nbv.cache import Store
    from nbv.rocks import load_rock

    for number, rock in enumerate(rocks, 1):
        with said_if_slow(f"making rock {rock} ({number} of {len(rocks)}); it is kept for later"):
            load_rock(rock, Store())
    return [str(Path(rock).resolve()) if Path(rock).is_file() else rock for rock in rocks]


def local_executor(
    runner: str, workers: int | None, timeout_s: float, mission: MissionFile | None = None
) -> LocalProcessExecutor:
    """Processes for missions, one per core unless told otherwise; a mission file has limits of its own."""
    from tuner.missions.executors import LocalProcessExecutor

    if workers is not None and workers < 1:
        raise UserError(f"--workers is {workers}; give at least 1")
    count = workers or len(os.sched_getaffinity(0))
    if mission is None:
        return LocalProcessExecutor(count, timeout_s, preload=(runner,))
    # The runner keeps the limit itself; this one is for a runner that hangs. Before it there may be a wait for a slot.
    limit_s = 2 * (mission.time_limit_s + 2 * mission.stop_grace_s) + _SCORING_S
    return LocalProcessExecutor(min(count, mission.at_once), limit_s, (runner,), mission.retries + 1)


def cluster_executor(
    where: str, scheduler: str | None, workers: int | None, timeout_s: float, *, unencrypted: bool
) -> DaskExecutor:
    """Workers of a Dask scheduler, which is started where none is named.

    Raises
    ------
    UserError
        The extra is not installed; as `tuner.missions.cluster.connect.dask_executor`.
    """
    try:
        from tuner.missions.cluster.connect import WHERE, dask_executor
    except ImportError as error:
        raise UserError(
            f"--executor {where} needs an extra ({error}); install it: pip install 'gatetune[cluster]'"
        ) from error
    if where not in WHERE:
        raise UserError(f"unknown executor {where!r}; there are local, {', '.join(WHERE)}")
    count = workers or len(os.sched_getaffinity(0))
    return dask_executor(where, scheduler, count, timeout_s, unencrypted=unencrypted)


def seconds(value: float) -> str:
    """``75.2`` as ``1 min 15 s``."""
    if value < 90:
        return f"{value:.0f} s"
    if value < 5400:
        return f"{value // 60:.0f} min {value % 60:.0f} s"
    return f"{value // 3600:.0f} h {value % 3600 // 60:.0f} min"
