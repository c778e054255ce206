"""``gatetune evaluate``, ``confirm`` and ``reproduce``, jobs 2 and 3: strategies run against each other."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from nbv.config import IDEAL, load_conditions
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from tuner.campaign.campaign import Campaign
from tuner.commands.campaign_display import show_answer
from tuner.commands.console import (
    LOADING,
    LOADING_ROCKS,
    AsJson,
    ComparisonProgress,
    answer_json,
    mission_config,
    note_dense_stage,
    output,
    require_complete,
    under_conditions,
    working,
)
from tuner.commands.options import (
    Conditions,
    Fidelity,
    MissionAllowed,
    Overrides,
    Rocks,
    Timeout,
    TunedRocks,
    Workers,
)
from tuner.comparison.advice import advice_of, next_step
from tuner.comparison.of_campaign import PlannedComparison, confirmation, held_out, reproduction
from tuner.comparison.result import ComparisonFacts
from tuner.missions.executors import Executor
from tuner.missions.registry import DEFAULT_FIDELITY, kind_on, mission_kind
from tuner.report.answer import advice_lines, next_text
from tuner.report.labels import counted, duration


def evaluate(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: Rocks = None,
    conditions: Conditions = None,
    replicates: Annotated[int, typer.Option(help="Replicates per rock, the same for all strategies.")] = 3,
    strategies: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            help="Baseline, repeatable (default: the paper's four, predicted, random, greedy-oracle and orbits).",
        ),
    ] = None,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/evaluation).")] = None,
    mission: MissionAllowed = None,
    as_json: AsJson = False,
) -> None:
    """Job 2: run the recommendation and the baselines on held-out rocks; print a table with intervals.

    Example: gatetune evaluate runs/mine --replicates 3
    """
    output.print(f"evaluating the recommendation of {campaign}")
    source = _open(campaign, mission)
    with working(LOADING[source.settings.problem.instance_word]):
        planned = held_out(
            source,
            rocks=rocks,
            replicates=replicates,
            strategies=strategies,
            conditions=load_conditions(conditions) if conditions else None,
            fidelity=fidelity,
        )
    run_and_report(planned, out, workers, timeout_s)


def confirm(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: TunedRocks = None,
    replicates: Annotated[
        int, typer.Option(help="Replicates per rock, none of them run by the campaign.")
    ] = 4,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/confirmation).")] = None,
    mission: MissionAllowed = None,
    as_json: AsJson = False,
) -> None:
    """Run the recommendation, the default and plain orbits on training rocks in new replicates; print whether the rocks gained.

    Example: gatetune confirm runs/mine --rock mine
    """
    output.print(f"confirming the recommendation of {campaign}")
    source = _open(campaign, mission)
    with working(LOADING[source.settings.problem.instance_word]):
        planned = confirmation(source, rocks=rocks, replicates=replicates, fidelity=fidelity)
    if planned is None:
        note = f"{campaign} recommends to keep the default: there is nothing to confirm"
        output.print(note)
        return answer_json({"notes": [note]})
    run_and_report(planned, out, workers, timeout_s)


def _open(directory: Path, mission: Path | None) -> Campaign:
    source = Campaign.open(directory, read_only=True, mission=mission)
    source.settings.problem.require_named(mission is not None)
    return source


def reproduce(
    rocks: Annotated[
        list[str] | None, typer.Option("--rock", help="Rock or mesh file, repeatable (default: vesicular).")
    ] = None,
    preset: Annotated[
        str,
        typer.Option(help="paper (the text), paper-reduced (faster SfM) or paper-code (the public code)."),
    ] = "paper",
    conditions: Conditions = None,
    replicates: Annotated[int, typer.Option(help="Replicates per rock; the paper ran one.")] = 1,
    strategies: Annotated[
        list[str] | None,
        typer.Option("--strategy", help="Strategy, repeatable (default: the paper's four, greedy-oracle)."),
    ] = None,
    set_: Overrides = None,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    workers: Workers = None,
    timeout_s: Timeout = 7200.0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: runs/reproduce).")] = None,
    as_json: AsJson = False,
) -> None:
    """Job 3: run the paper's configuration with its four strategies and the greedy oracle; print Table I beside the paper's.

    Example: gatetune reproduce --replicates 3
    """
    output.print(f"reproducing Table I with preset {preset}")
    base = mission_config(preset, set_ or [])
    with working(LOADING_ROCKS):
        planned = reproduction(
            base,
            rocks or ["vesicular"],
            strategies=strategies,
            replicates=replicates,
            conditions=load_conditions(conditions or [IDEAL]),
            fidelity=fidelity,
            keep="all",
        )
    run_and_report(planned, out, workers, timeout_s)


def run_and_report(
    planned: PlannedComparison, out: Path | None, workers: int | None, timeout_s: float
) -> None:
    """Run what is missing, say what was found, write the report, and the page of the campaign, which shows what it found, anew.

    Table I is shown with the paper's numbers beside it.
    """
    from tuner.report import comparison

    plan, paper = planned.plan, planned.source is None
    executor = planned.executor(workers, timeout_s)
    taken = [rock for rock in plan.rocks if kind_on(rock, plan.fidelity).photographs == "taken"]
    not_counted = planned.not_counted(out)
    said = filter(None, [mission_kind(plan.fidelity).note, not_counted])
    notes = (*planned.notes, *said, *map(_ceiling, taken))
    planned = dataclasses.replace(planned, notes=notes)
    for note in notes:
        output.print(note, style="yellow")
    named = comparison.strategies_text(plan.strategies) if paper else f"{len(plan.strategies)} strategies"
    output.print(
        f"{named} on {counted(len(plan.rocks), planned.word)}, {counted(plan.replicates, 'replicate')} each{under_conditions(plan.conditions)}: "
        f"{plan.missions} missions, {counted(executor.capacity, 'worker')}"
    )
    note_dense_stage(mission_kind(plan.fidelity), next(iter(plan.strategies.values())))
    with executor:
        facts, report = run_comparison(planned, executor, out, f"gatetune {shlex.join(sys.argv[1:])}")
    for line in comparison.verdict_lines(facts):
        output.print(line, style="bold")
    answer = {} if planned.source is None else show_all_results(planned.source, not_counted)
    tables = {f"Under {name}": table for name, table in facts.conditions.items()}
    if not answer.pop("tables", False):
        tables = {"Results by strategy": facts.summary, **tables}
    shown = [comparison.strategy_table(t, name, planned.goal.shown.metric) for name, t in tables.items()]
    if paper and "whole" in facts.tables:  # no mission that has ended well, no table
        table_i = facts.tables["whole"]
        shown.append(comparison.table_i(table_i, "Table I, whole surface", paper=True, differences=False))
    for table in shown:
        output.print(*table.for_terminal())
    if paper:
        output.print(comparison.paper_note(plan.fidelity))
    output.print(f"{duration(facts.run.elapsed_s)}; report: {report}")
    document = comparison.evaluation_document(facts)
    answer_json({"title": planned.title, "directory": report.parent, "report": report, **document, **answer})
    for reason, times in facts.run.failures.items():
        output.print(f"failed {times} times: {reason}", style="red")
    require_complete(facts.run)


def run_comparison(
    planned: PlannedComparison, executor: Executor, out: Path | None = None, command: str = ""
) -> tuple[ComparisonFacts, Path]:
    """Run what is missing and write the report; return what was found, and the report."""
    from tuner.report.comparison import write_comparison_report

    with ComparisonProgress(planned.goal.shown.metric) as show:
        facts = ComparisonFacts(planned, planned.run(executor, show, out))
    with working("writing the report"):
        return facts, write_comparison_report(facts, command)


def show_all_results(campaign: Campaign, not_counted: str) -> dict[str, Any]:
    """Print the campaign's tables, what to fly and what next, anew from all results, which its page has, too; return what was said.

    ``not_counted``: why what has just run is not among them; empty where it is.
    """
    from tuner.report.campaign_page import write_campaign_report

    best = campaign.recommended()
    advice = advice_of(campaign, best)
    try:
        with working("writing the campaign's report"):
            write_campaign_report(campaign)
    except UserError as error:  # of a campaign that may only be read; what was run is said all the same
        output.print(f"its page stays as it was: {error}", highlight=False, soft_wrap=True)
    tables = show_answer(campaign, best)
    said = advice_lines(advice, best, campaign.settings)
    why, command = next_text(next_step(campaign, best, advice), campaign, advice)
    for line in said:
        output.print(line, style="bold", highlight=False)
    if not_counted:
        output.print(not_counted, style="yellow")
    output.print(f"What next: {why}", highlight=False)
    if command:
        output.print(command, highlight=False, soft_wrap=True)
    return {"tables": tables, "advice": said, "next": {"why": why, "command": command}}


def _ceiling(name: str) -> str:
    """The best score that a photograph set can show: that of one half of its photographs against the other."""
    from nbv.photographs.photograph_fidelity import ceiling

    halves = ceiling(PhotographSet.read(name))
    return (
        f"{name} is a set of photographs: 48 mm are 3 % of its height. The cloud of one half of its photographs, measured "
        f"against the other half's, has an F-score of {halves['f_score_48mm']:.1f} % and a completeness of "
        f"{halves['completeness_48mm']:.1f} %."
    )
