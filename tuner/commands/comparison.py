"""Flying and showing a comparison: shared by ``gatetune evaluate`` and ``gatetune reproduce``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.markup import escape

from tuner.commands.console import (
    FlightProgress,
    beating,
    local_executor,
    output,
    progress_bar,
    seconds,
    under_conditions,
    working,
)
from tuner.problem.worlds import World

if TYPE_CHECKING:
    from rich.progress import Progress

    from tuner.evaluation.flying import EvaluationEvent
    from tuner.evaluation.plan import EvaluationPlan
    from tuner.missions.external import MissionFile
    from tuner.problem.objective import Objective
    from tuner.report.comparison.verdicts import LimitAsked


class ComparisonProgress(FlightProgress):
    """A line per mission and one bar."""

    def __init__(self, progress: Progress, metric: str) -> None:
        super().__init__(progress, None)
        self._metric = metric

    def __call__(self, event: EvaluationEvent) -> None:
        from tuner.evaluation.plan import EvaluationRecord
        from tuner.report.labels import metric_label

        self.counts = f"{event.finished}/{event.total}"
        self.reached(event.finished, event.total)
        if event.job is None:
            return
        world = World(Path(event.job.rock).stem, event.job.config.condition)
        strategy = event.job.id.split("/")[0]
        if event.outcome is None:
            label = f"{strategy} {world.label} r{event.job.replicate}"
            return self.took_off(event.job.id, label, event.job.directory)
        self.landed(event.job.id)
        if event.kind == "failed":
            text = f"[red]failed: {escape(event.outcome.reason)}[/] {escape(event.outcome.message)}"
        else:
            value = EvaluationRecord(strategy, "", 0, event.outcome).value(self._metric)
            name = metric_label(self._metric).name
            text = f"{name} [bold]{'not measured' if value is None else f'{value:6.2f}'}[/]"
        self.say(
            f"{strategy:<14} {escape(world.label):<16} r{event.job.replicate} {text}  "
            f"{event.outcome.wall_s:4.0f} s",
            markup=True,
        )


def compare(
    plan: EvaluationPlan,
    directory: Path,
    *,
    workers: int | None,
    timeout_s: float,
    objective: Objective,
    reference: str | None,
    title: str,
    paper: bool,
    mission: MissionFile | None = None,
    asked: LimitAsked | None = None,
) -> None:
    """Fly what is missing, print Table I's layout with intervals, write the report."""
    from tuner.evaluation.comparison import comparison_table
    from tuner.evaluation.flying import run_evaluation
    from tuner.report import write_comparison_report
    from tuner.report.comparison.page import leading_verdict
    from tuner.report.comparison.tables import (
        PAPER_NOT_COMPARABLE,
        comparison_terminal_table,
        difference_terminal_table,
        mission_file_rows,
    )
    from tuner.report.comparison.verdicts import limit_rows

    executor = local_executor(plan.fidelity, workers, timeout_s, mission)
    output.print(
        f"{len(plan.strategies)} strategies on {len(plan.rocks)} {'rock' if len(plan.rocks) == 1 else 'rocks'} x {plan.replicates} replicates{under_conditions(plan.conditions)}: "
        f"{plan.missions} missions, {executor.capacity} workers"
    )
    with executor, progress_bar() as bar:
        show = ComparisonProgress(bar, objective.metric)
        with beating(show.tick):
            run = run_evaluation(plan, directory, executor, show)
    ours = mission is None or mission.score is not None
    rows = None if ours else mission_file_rows(objective, run.records)
    if sentence := leading_verdict(run, reference, objective.metric, rows, asked):
        output.print(sentence, style="bold")
    several = len(plan.conditions) > 1
    for condition in plan.conditions if several else ():
        own = [r for r in run.records if r.condition == condition.name]
        output.print(f"under {condition.name}:")
        output.print(
            comparison_terminal_table(comparison_table(own, tuple(plan.strategies), reference), paper=paper),
            markup=True,
        )
    if several:
        output.print("over all conditions:")
    if rows is None:
        name = "Dense cloud against ground truth"
        table = comparison_table(run.records, tuple(plan.strategies), reference)
    else:
        name = "Metrics and costs"
        table = comparison_table(run.records, tuple(plan.strategies), reference, None, rows)
    shown = limit_rows(table, run.records, asked)
    output.print(comparison_terminal_table(shown, title=name, paper=paper), markup=True)
    if (differences := difference_terminal_table(table)) is not None:
        output.print(differences, markup=True)
    if paper:
        output.print(PAPER_NOT_COMPARABLE)
    with working("writing the report"):
        report = write_comparison_report(
            run,
            directory,
            title=title,
            reference=reference,
            metric=objective.metric,
            paper=paper,
            command=f"gatetune {shlex.join(sys.argv[1:])}",
            rows=rows,
            asked=asked,
        )
    output.print(f"{seconds(run.elapsed_s)}; report: {report}")
    for reason, times in run.failures.items():
        output.print(f"failed {times} times: {reason}", style="red")
    if not run.complete:
        output.print("not complete; the same command goes on where it stopped")
        raise typer.Exit(130)
