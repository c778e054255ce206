"""The two rich consoles, what is said while something takes long, and small helpers that commands share."""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from nbv.config import IDEAL, PRESETS, Condition, MissionConfig, load_condition, preset, under
from nbv.dense import best_dense_stage
from nbv.errors import UserError
from nbv.mission.result import json_ready
from nbv.safe_files import parse_yaml
from tuner.campaign import rock_choice
from tuner.missions.executors import local_executor
from tuner.missions.progress import progress_of

if TYPE_CHECKING:
    from tuner.missions.cluster.executor import DaskExecutor
    from tuner.missions.executors import LocalProcessExecutor
    from tuner.missions.external import MissionFile

# Names of rocks, campaigns and files may look like markup: it is read only where ``markup=True`` says so.
output = Console(markup=False, emoji=False)
errors = Console(stderr=True, markup=False, emoji=False)
PRESET_NAMES = ", ".join(PRESETS)  # help of --preset
CONDITION_HELP = "World to fly in: a name of conditions/, or a YAML file."


Verbosity = Literal["all", "quiet", "json"]
_SLOW_S, _INTERVAL_S, _TICK_S = 1.5, 10.0, 0.5
_REPEAT_S = 30.0  # after which a line is said again that has not changed
_NAMED = 2  # missions in flight that a line names
_verbosity: list[Verbosity] = ["all"]


def set_verbosity(how: Verbosity) -> None:
    """Set what commands print from here on; every command begins with "all"."""
    _verbosity[0] = how
    output.quiet = how != "all"


def _only_json(wanted: bool) -> bool:
    if wanted:
        set_verbosity("json")
    return wanted


# What lists or shows takes this option and ends with `answer_json`; what it prints on the way is not shown then.
AsJson = Annotated[
    bool,
    typer.Option("--json", callback=_only_json, help="The same as one JSON document, and nothing else."),
]


def answer_json(document: Any) -> None:
    """Print what a command shows as one JSON document, where ``--json`` asked for it."""
    if verbosity() == "json":
        typer.echo(json.dumps(json_ready(document), indent=1))


def verbosity() -> Verbosity:
    """Return what `set_verbosity` has set."""
    return _verbosity[0]


def progress_bar() -> Progress:
    """The bar that all commands use."""
    return Progress(_description(), BarColumn(), TimeElapsedColumn(), console=output)


def _description() -> TextColumn:
    """Return a bar's text column without markup: a rock's file may have any name."""
    return TextColumn("{task.description}", markup=False)


@contextlib.contextmanager
def ticker(tick: Callable[[], None]) -> Iterator[None]:
    """Call ``tick`` twice a second, from a thread, while what is inside goes on."""
    over = threading.Event()

    def run() -> None:
        while not over.wait(_TICK_S):
            tick()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def working(text: str, *, silent: bool = False) -> Iterator[None]:
    """Say what goes on where it takes longer than a moment: with a clock in a terminal, else in a line."""
    if silent or output.quiet:
        yield
        return
    if output.is_terminal:
        with Progress(_description(), TimeElapsedColumn(), console=output, transient=True) as clock:
            clock.add_task(text, total=None)
            yield
        return
    line = threading.Timer(_SLOW_S, functools.partial(output.print, text, soft_wrap=True))
    line.start()
    try:
        yield
    finally:
        line.cancel()


def load(module: str) -> None:
    """Import what takes seconds to load, and say so where it does."""
    with working("loading libraries"):
        importlib.import_module(module)


class FlightProgress:
    """One bar, or lines where none can be drawn: how far it is, and what the missions in flight are doing."""

    def __init__(self, progress: Progress, total: int | None) -> None:
        self.progress, self.counts = progress, ""
        self._task = progress.add_task("missions", total=total)
        self._flights: dict[str, tuple[str, Path]] = {}
        self._said_s, self._last = time.monotonic(), ""

    def took_off(self, key: str, label: str, directory: Path) -> None:
        """A mission, and where it says what it is doing."""
        self._flights[key] = (label, directory)

    def landed(self, key: str) -> None:
        """It is over."""
        self._flights.pop(key, None)

    def reached(self, finished: int, total: int) -> None:
        """So many missions."""
        self.progress.update(self._task, completed=finished, total=total)
        self.tick()

    def tick(self) -> None:
        """Say what goes on; may be called from any thread."""
        text = f"{self.counts}{self._aloft()}"
        self.progress.update(self._task, description=text)
        silent_s = time.monotonic() - self._said_s
        if not self.progress.console.is_terminal and silent_s > (
            _INTERVAL_S if text != self._last else _REPEAT_S
        ):
            self._last = text
            self.say(text)

    def say(self, line: str, *, markup: bool = False) -> None:
        """A line of its own."""
        self._said_s = time.monotonic()
        self.progress.console.print(line, highlight=False, soft_wrap=True, markup=markup)

    def _aloft(self) -> str:
        """``, flies slab r0 (photograph 3/24), fin r1 (seed model) and 6 more``; empty where none is."""
        flights = list(self._flights.values())
        if not flights:
            return ""
        named = [
            f"{label} ({doing})" if (doing := progress_of(directory)) else label
            for label, directory in flights[:_NAMED]
        ]
        more = f" and {len(flights) - _NAMED} more" if len(flights) > _NAMED else ""
        return f", flies {', '.join(named)}{more}"


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
    chosen = best_dense_stage(values)
    note_dense_stage(values, chosen)
    return under(preset(preset_name), load_condition(condition)).with_values(chosen)


def note_dense_stage(given: Mapping[str, Any], chosen: Mapping[str, Any]) -> None:
    """Say where a better dense stage was chosen than nobody asked for."""
    if "dense.backend" in chosen and "dense.backend" not in given:
        output.print(
            "dense stage: COLMAP's PatchMatch, since this machine has CUDA (--set dense.backend=sgbm for the CPU's)"
        )


def under_conditions(conditions: Sequence[Condition]) -> str:
    """``" under field, harsh"``; nothing under ``ideal`` alone."""
    names = [condition.name for condition in conditions]
    return "" if names == [IDEAL] else f" under {', '.join(names)}"


def rock_arguments(rocks: list[str]) -> list[str]:
    """As `tuner.campaign.rock_choice.rock_arguments`, saying which rock is made."""
    return rock_choice.rock_arguments(rocks, working)


def executor_at(
    where: tuple[str, str | None, bool],
    fidelity: str,
    workers: int | None,
    timeout_s: float,
    mission: MissionFile | None = None,
) -> LocalProcessExecutor | DaskExecutor:
    """Processes here, or workers of a Dask scheduler, which is started where none is named.

    Parameters
    ----------
    where
        The options executor, scheduler and unencrypted.
    fidelity
        What flies.
    workers
        Side by side; by default one per core.
    timeout_s
        A mission that takes longer is killed.
    mission
        The mission file, of missions that are not ours.

    Raises
    ------
    UserError
        The extra is not installed; as `tuner.missions.cluster.connect.dask_executor`.
    """
    kind, scheduler, unencrypted = where
    if kind == "local" and scheduler is None:
        return local_executor(fidelity, workers, timeout_s, mission)
    kind = "dask" if kind == "local" else kind
    try:
        from tuner.missions.cluster.connect import WHERE, dask_executor
    except ImportError as error:
        raise UserError(
            f"--executor {kind} needs an extra ({error}); install it: pip install 'gatetune[cluster]'"
        ) from error
    if kind not in WHERE:
        raise UserError(f"unknown executor {kind!r}; there are local, {', '.join(WHERE)}")
    count = workers or len(os.sched_getaffinity(0))
    return dask_executor(kind, scheduler, count, timeout_s, unencrypted=unencrypted)


def workers_text(executor: LocalProcessExecutor | DaskExecutor) -> str:
    """Return how many workers there are, as text; where a cluster has none yet, what missions do meanwhile."""
    count = getattr(executor, "workers", executor.capacity)
    if not count:
        return "no worker yet: missions wait for the first"
    return f"{count} worker{'s' if count > 1 else ''}"


def seconds(value: float) -> str:
    """``75.2`` as ``1 min 15 s``."""
    if value < 90:
        return f"{value:.0f} s"
    if value < 5400:
        return f"{value // 60:.0f} min {value % 60:.0f} s"
    return f"{value // 3600:.0f} h {value % 3600 // 60:.0f} min"
