"""What commands of studies have in common: options, the flight, the last lines; a function run by ``python -m``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nbv.errors import UserError
from tuner.campaign.rock_choice import refuse_held_out
from tuner.commands.console import ComparisonProgress, output, rock_arguments

if TYPE_CHECKING:
    from research.study_directory import StudySettings

SetForAll = Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE for every mission.")]
Out = Annotated[Path, typer.Option(help="Directory; the same command goes on where it stopped.")]
QuickRocks = Annotated[
    list[str] | None,
    typer.Option("--rock", help="Training rock or mesh file, repeatable (default: slab, vesicular, cavern)."),
]
Surface = Annotated[str, typer.Option(help="observable or whole.")]
Fidelity = Annotated[
    str, typer.Option(help="photogrammetric, or geometric: seconds instead of hours, no photographs.")
]
ReportOnly = Annotated[bool, typer.Option("--report-only", help="Fly nothing; report on what --out holds.")]


def study_rocks(rocks: list[str] | None, otherwise: list[str]) -> tuple[str, ...]:
    """Training rocks, looked up; ``UserError`` for one that is unknown or held out."""
    chosen = rock_arguments(rocks or otherwise)
    refuse_held_out(chosen)
    return tuple(chosen)


def fly_study(
    settings: StudySettings, directory: Path, workers: int | None, timeout_s: float, metric: str
) -> bool:
    """Fly what is missing, with one line per mission; whether the study is complete.

    Raises
    ------
    UserError
        Fewer than one worker; as `research.study_directory.run_jobs`.
    """
    from research.study_directory import run_jobs
    from tuner.missions.executors import LocalProcessExecutor

    if workers is not None and workers < 1:
        raise UserError(f"--workers is {workers}; give at least 1")
    count = workers or len(os.sched_getaffinity(0))
    plans = settings.plans()
    fidelities = tuple(dict.fromkeys(plan.fidelity for plan in plans.values()))
    sizes = ", ".join(
        f"{len(plan.strategies)} configurations x {len(plan.rocks)} rocks x {plan.replicates} replicates"
        for plan in plans.values()
    )
    output.print(f"{sizes}: {settings.missions} missions, {count} workers")
    with (
        LocalProcessExecutor(count, timeout_s=timeout_s, preload=fidelities) as executor,
        ComparisonProgress(metric) as show,
    ):
        return run_jobs(settings, directory, executor, show)


def end_study(failures: dict[str, int], missions: int, expected: int, report: Path, complete: bool) -> None:
    """What failed, how much is flown, where the report is; exit code 130 if interrupted."""
    for reason, times in failures.items():
        output.print(f"failed {times} times: {reason}", style="red")
    output.print(f"{missions} of {expected} missions; report: {report}")
    if not complete:
        output.print("interrupted; the same command goes on where it stopped")
        raise typer.Exit(130)


def run(*commands: Callable[..., None]) -> None:
    """Run one command, or the one of several that the first argument names; a user's mistake is one line, exit 2."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(command)
    try:
        app()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
