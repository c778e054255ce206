"""Flying and showing a comparison: shared by ``gatetune evaluate`` and ``gatetune reproduce``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from nbv.rocks.imported import is_photographed
from tuner.commands.console import (
    FlightProgress,
    answer_json,
    local_executor,
    output,
    seconds,
    under_conditions,
    working,
)
from tuner.missions.registry import GEOMETRIC_NOTE, is_geometric
from tuner.problem.worlds import World

if TYPE_CHECKING:
    from tuner.evaluation.flying import EvaluationEvent, EvaluationRun
    from tuner.evaluation.of_campaign import CampaignEvaluation
    from tuner.missions.external import MissionFile
    from tuner.report.comparison.facts import ComparisonFacts


class ComparisonProgress(FlightProgress):
    """A line per mission and one bar."""

    def __init__(self, metric: str) -> None:
        super().__init__()
        self._metric = metric

    def __call__(self, event: EvaluationEvent) -> None:
        job, trial = event.job, event.trial
        world, strategy = World(Path(job.rock).stem, job.config.condition), job.id.split("/")[0]
        if trial is None:
            self.took_off(job.id, f"{strategy} {world.label} r{job.replicate}")
        else:
            value = trial.value(self._metric)
            text = f"{self._metric} " + ("not measured" if value is None else f"{value:.2f}")
            if trial.status == "failed":
                text = f"failed: {trial.reason} {trial.message}"
            line = f"{strategy:<14} {world.label:<16} r{job.replicate} {text}  {trial.wall_s:.0f} s"
            self.landed(job.id, line)
        self.reached(event.finished, event.total, f"{event.finished}/{event.total}")


def compare(
    asked: CampaignEvaluation,
    usual: Path,
    out: Path | None,
    *,
    workers: int | None,
    timeout_s: float,
    title: str,
    paper: bool = False,
    mission: MissionFile | None = None,
) -> None:
    """Fly what is missing, say what was found, write the report.

    Parameters
    ----------
    asked
        What is flown, against what, in which metrics.
    usual, out
        The evaluation's directory, or one beside it that holds nothing else; the one that the user named.
    workers, timeout_s
        Of the processes here.
    title
        Of the page.
    paper
        Show the paper's numbers beside.
    mission
        The mission file, of missions that are not ours.
    """
    from tuner.evaluation.flying import place_for, run_evaluation
    from tuner.report.comparison.facts import comparison_facts
    from tuner.report.comparison.page import write_comparison_report
    from tuner.report.comparison.verdicts import counted

    plan, place = asked.plan, asked.asked.place
    directory = out or place_for(plan, usual)
    executor = local_executor(plan.fidelity, workers, timeout_s, mission)
    notes = (*asked.notes, GEOMETRIC_NOTE) if is_geometric(plan.fidelity) else asked.notes
    notes = (*notes, *(_ceiling(rock) for rock in plan.rocks if is_photographed(rock)))
    for note in notes:
        output.print(note, style="yellow")
    output.print(
        f"{len(plan.strategies)} strategies on {counted(len(plan.rocks), place)}, {counted(plan.replicates, 'replicate')} each{under_conditions(plan.conditions)}: "
        f"{plan.missions} missions, {counted(executor.capacity, 'worker')}"
    )
    with executor, ComparisonProgress((asked.asked.quality or asked.asked.objective).metric) as show:
        run = run_evaluation(plan, directory, executor, show)
    facts = comparison_facts(run, asked.reference, asked.asked, notes=notes)
    _show(facts, paper=paper)
    with working("writing the report"):
        report = write_comparison_report(
            facts, directory, title=title, paper=paper, command=f"gatetune {shlex.join(sys.argv[1:])}"
        )
    output.print(f"{seconds(run.elapsed_s)}; report: {report}")
    answer_json({"title": title, "directory": str(directory), "report": str(report), **facts.to_dict()})
    end(run)


def end(run: EvaluationRun) -> None:
    """Say what failed; the exit code says whether all has flown."""
    for reason, times in run.failures.items():
        output.print(f"failed {times} times: {reason}", style="red")
    if not run.complete:
        output.print("not complete; the same command goes on where it stopped")
        raise typer.Exit(130)


def _ceiling(name: str) -> str:
    """What nobody can be told to be better than, over the photographs of a set."""
    from nbv.photographs import PhotographSet
    from nbv.photographs.evaluation import ceiling

    found = ceiling(PhotographSet.read(name))
    return (
        f"{name} is a set of photographs: 48 mm are 3 % of its height, and one half of its photographs against the other "
        f"has an F-score of {found['f_score_48mm']:.1f} %, a completeness of {found['completeness_48mm']:.1f} % there."
    )


def _show(facts: ComparisonFacts, *, paper: bool) -> None:
    """The verdicts, then the tables."""
    from tuner.report.comparison.tables import (
        PAPER_NOT_COMPARABLE,
        strategies_for_terminal,
        table_i_for_terminal,
    )

    for line in facts.verdicts:
        output.print(line.text, style="bold")
    tables = {"What was flown, and what it got": facts.summary}
    tables |= {f"Under {name}": table for name, table in facts.conditions.items()}
    for title, table in tables.items():
        output.print(strategies_for_terminal(table, title), markup=True)
    if paper:
        output.print(table_i_for_terminal(facts.tables["whole"], "Table I, whole surface"), markup=True)
        output.print(PAPER_NOT_COMPARABLE)
