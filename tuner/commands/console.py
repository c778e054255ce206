"""The two rich consoles, progress displays, and small helpers that commands share."""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

from nbv.config import (
    IDEAL,
    PRESETS,
    Condition,
    MissionConfig,
    load_condition,
    preset,
    under,
)
from nbv.dense import patchmatch_runs, with_best_dense_stage
from nbv.dense.patchmatch import cards
from nbv.errors import UserError
from nbv.mission.run_directory import PROGRESS
from nbv.safe_files import json_ready, parse_yaml
from tuner.campaign.settings import CampaignSettings
from tuner.comparison.plan import EvaluationEvent, EvaluationPlan, EvaluationRun, run_evaluation
from tuner.missions.pool import Executor, local_pool
from tuner.missions.registry import MissionKind
from tuner.problem.instances import Instance
from tuner.report.labels import Table, duration, number_text

# Names of rocks, campaigns and files may look like markup: it is read only where ``markup=True`` says so.
output = Console(markup=False, emoji=False)
errors = Console(stderr=True, markup=False, emoji=False)
PRESET_NAMES = ", ".join(PRESETS)  # help of --preset
CONDITION_HELP = "Condition, a name or a YAML file."
LOADING_ROCKS = "loading rocks; one that is used for the first time is made and kept"
_SLOW_S, _PER_SECOND = 1.5, 2.0
_ENOUGH = 6  # missions from which on the time left is estimated
_NAMED = 2  # missions in flight that a line names


def only_json(wanted: bool) -> bool:
    """Print one JSON document, or one per event, and nothing else from here on; every command begins without."""
    output.quiet = wanted
    return wanted


# Commands that show a result take this option and end with `answer_json`; with it their other output is not shown.
AsJson = Annotated[
    bool,
    typer.Option(
        "--json", callback=only_json, help="Print JSON (a campaign: an object per event) and nothing else."
    ),
]


def answer_json(document: Any) -> None:
    """Print what a command shows as one JSON document, where ``--json`` asked for it."""
    if output.quiet:
        typer.echo(json.dumps(json_ready(document), indent=1))


def show_table(columns: Sequence[str], rows: Iterable[Sequence[object]], title: str = "") -> None:
    """Print a table."""
    texts = [[str(value) for value in row] for row in rows]
    output.print(*Table.of(title, columns, texts).for_terminal())


@contextlib.contextmanager
def working(text: str) -> Iterator[None]:
    """Show ``text`` while the body runs: a spinner in a terminal, else a line if it takes more than `_SLOW_S`."""
    if output.quiet or output.is_terminal:
        with output.status(Text(text)):
            yield
        return
    line = threading.Timer(_SLOW_S, functools.partial(output.print, text, soft_wrap=True))
    line.start()
    try:
        yield
    finally:
        line.cancel()


def load(module: str) -> None:
    """Import a module that may take seconds to load, with a message while it does."""
    with working("loading libraries"):
        importlib.import_module(module)


class MissionProgress(Progress):
    """One progress bar with the missions that are running; above it a line for each that has ended."""

    def __init__(self, total: int | None = None) -> None:
        # A rock's file may have any name, so it is no markup.
        super().__init__(
            TextColumn("{task.description}", markup=False, table_column=Column(overflow="fold")),
            BarColumn(16),
            TimeElapsedColumn(),
            TextColumn("elapsed{task.fields[left]}"),
            console=output,
            refresh_per_second=_PER_SECOND,
        )
        self._first: int | None = None  # missions that had finished before this session
        self._running: dict[str, tuple[str, Path]] = {}
        self._counts = ""
        self._missions = self.add_task("", total=total, left="")

    def launched(self, key: str, label: str, directory: Path) -> None:
        self._running[key] = label, directory

    def ended(self, key: str, line: str) -> None:
        self._running.pop(key, None)
        output.print(line, highlight=False, soft_wrap=True)

    def reached(self, finished: int, total: int, counts: str) -> None:
        self._counts = counts
        self._first = finished if self._first is None else self._first
        here, elapsed_s = finished - self._first, self.tasks[0].elapsed or 0.0
        # The first missions make rocks and fill the store, so few of them say little.
        left = (
            f", {duration(elapsed_s / here * (total - finished))} left"
            if here >= _ENOUGH and finished < total
            else ""
        )
        self.update(
            self._missions, completed=finished, total=total, description=self.description(), left=left
        )

    def description(self) -> str:
        """``3/9, runs slab r0 (photograph 12/32), fin r1 (photograph 3/32) and 6 more``."""
        running = list(self._running.values())
        named = ", ".join(label + _how_far(directory) for label, directory in running[:_NAMED])
        more = f" and {len(running) - _NAMED} more" if len(running) > _NAMED else ""
        return f"{self._counts}, runs {named}{more}" if named else self._counts

    def get_renderables(self) -> Iterable[RenderableType]:
        for task in self.tasks:
            task.description = self.description()
        return super().get_renderables()


def _how_far(directory: Path) -> str:
    """``" (photograph 12/32)"``; empty for a mission that has not written its progress yet."""
    try:
        lines = (directory / PROGRESS).read_text().splitlines()
    except (OSError, UnicodeDecodeError):
        return ""
    return f" (photograph {lines[-1]})" if lines else ""


class ComparisonProgress(MissionProgress):
    """A line per mission and one bar."""

    def __init__(self, metric: str) -> None:
        super().__init__()
        self._metric = metric

    def __call__(self, event: EvaluationEvent) -> None:
        job, trial = event.job, event.trial
        instance, strategy = Instance(Path(job.rock).stem, job.config.condition), job.id.split("/")[0]
        if trial is None:
            self.launched(job.id, f"{strategy} {instance.label} r{job.replicate}", job.directory)
        else:
            value = trial.value(self._metric)
            text = "not measured" if value is None else number_text(value)
            if trial.record.status == "failed":
                text = f"failed: {trial.reason} {trial.record.message}"
            line = f"{strategy:<22} {instance.label:<16} r{job.replicate} {text}  {trial.record.wall_s:.0f} s"
            self.ended(job.id, line)
        self.reached(event.finished, event.total, f"{event.finished}/{event.total}")


def require_complete(run: EvaluationRun, go_on: str = "repeat the command to continue") -> None:
    """End the command, with the exit code of an interruption, where missions of an evaluation have not run."""
    if not run.complete:
        output.print(f"not complete; {go_on}", soft_wrap=True)
        raise typer.Exit(130)


def run_plans(
    plans: Mapping[str, EvaluationPlan], out: Path, workers: int | None, timeout_s: float, metric: str
) -> list[EvaluationRun]:
    """Run every plan in its folder of ``out``; missions that have finished are not run again.

    Raises `UserError`, before the first mission: a strategy of a plan cannot run.
    """
    for plan in plans.values():
        plan.require_runnable()
    runs = list[EvaluationRun]()
    with local_pool(next(iter(plans.values())).fidelity, workers, timeout_s) as executor:
        for folder, plan in plans.items():
            with ComparisonProgress(metric) as show:
                runs.append(run_evaluation(plan, out / folder, executor, show))
            require_complete(runs[-1])
    return runs


def parse_overrides(assignments: list[str]) -> dict[str, Any]:
    """``["photographs=40"]`` as ``{"photographs": 40}``; values are YAML.

    Raises `UserError`: an assignment without ``=`` or with an unreadable value.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        path, separator, text = assignment.partition("=")
        if not separator or not path.strip():
            raise UserError(f"--set {assignment!r} must be PATH=VALUE, for example --set photographs=40")
        values[path.strip()] = parse_yaml(text, f"--set {assignment!r}")
    return values


def mission_config(
    preset_name: str,
    assignments: list[str],
    gate: str | None = None,
    condition: str | None = None,
    base: MissionConfig | None = None,
) -> MissionConfig:
    """The preset, or ``base``, under the condition where one is named, with ``--gate`` and ``--set`` applied."""
    values = parse_overrides(assignments)
    if gate is not None:
        values["gate.kind"] = gate
    if base is None or condition is not None:
        base = under(base or preset(preset_name), load_condition(condition or IDEAL))
    return base.with_values(with_best_dense_stage(values))


def note_dense_stage(kind: MissionKind, config: Any) -> None:
    """Say which dense stage missions with photographs run, on what, and about how long one takes, where that is known."""
    if not kind.photographs:
        return
    backend, photographs = config.dense.backend, config.photographs
    where = {"sgbm": "SGBM on the CPU", "patchmatch": "COLMAP's PatchMatch on "}.get(backend, backend)
    if backend == "patchmatch":
        where += ", ".join(card.name for card in cards()) or "the NVIDIA cards of its workers"
        where += ", one mission at a time on each (--set dense.backend=sgbm for the CPU's)"
    elif patchmatch_runs():
        where += ", though this machine has CUDA (a new run with --set dense.backend=patchmatch uses it)"
    takes = ""
    if kind.seconds is not None:
        about = duration(kind.seconds(config))
        takes = f"; a mission of {photographs} photographs takes about {about} on a quiet core"
    output.print(f"dense stage: {where}{takes}", soft_wrap=True)


def under_conditions(conditions: Sequence[Condition]) -> str:
    """``" under field, harsh"``; nothing under ``ideal`` alone."""
    names = [condition.name for condition in conditions]
    return "" if names == [IDEAL] else f" under {', '.join(names)}"


def executor_at(
    where: tuple[str, str | None], settings: CampaignSettings, workers: int | None, timeout_s: float
) -> Executor:
    """Processes here, or the workers of a Dask scheduler, for a campaign's missions.

    ``where``: the options executor and scheduler. ``workers``: missions in parallel here; by default one per core.

    Raises `UserError`: the extra is not installed; as `tuner.missions.dask_pool.DaskPool`.
    """
    kind, scheduler = where
    if kind not in ("local", "dask"):
        raise UserError(f"unknown executor {kind!r}; there are local and dask")
    if scheduler is None:
        if kind == "dask":
            raise UserError("--executor dask needs --scheduler, an address or the file that it writes")
        return local_pool(settings.fidelity, workers, timeout_s)
    try:
        from tuner.missions.dask_pool import DaskPool
    except ImportError as error:
        raise UserError(
            f"--executor dask needs an extra ({error}); install it: pip install 'gatetune[cluster]'"
        ) from error
    return DaskPool(scheduler, timeout_s)
