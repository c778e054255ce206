"""``gatetune evaluate``, ``confirm`` and ``reproduce``, jobs 2 and 3: strategies run against each other."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from nbv.config import IDEAL, load_conditions
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from tuner.campaign.campaign import Campaign
from tuner.commands.campaign_display import show_answer
from tuner.commands.console import (
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
    FidelityOption,
    Overrides,
    Rocks,
    Timeout,
    TunedRocks,
    Workers,
)
from tuner.comparison.of_campaign import PlannedComparison, confirmation, held_out, reproduction
from tuner.comparison.plan import EvaluationRun
from tuner.missions.pool import Executor, local_pool
from tuner.missions.registry import DEFAULT_FIDELITY, kind_on, mission_kind
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
    fidelity: FidelityOption = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/evaluation).")] = None,
    as_json: AsJson = False,
) -> None:
    """Job 2: run the recommendation and the baselines on held-out rocks; print a table with intervals.

    Example: gatetune evaluate runs/mine --replicates 3
    """
    output.print(f"evaluating the recommendation of {campaign}")
    source = Campaign.open(campaign, read_only=True)
    with working(LOADING_ROCKS):
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
    fidelity: FidelityOption = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/confirmation).")] = None,
    as_json: AsJson = False,
) -> None:
    """Run the recommendation, the default and plain orbits on training rocks in new replicates; print whether the rocks gained.

    Example: gatetune confirm runs/mine --rock mine
    """
    output.print(f"confirming the recommendation of {campaign}")
    source = Campaign.open(campaign, read_only=True)
    with working(LOADING_ROCKS):
        planned = confirmation(source, rocks=rocks, replicates=replicates, fidelity=fidelity)
    if planned is None:
        note = f"{campaign} recommends to keep the default: there is nothing to confirm"
        output.print(note)
        return answer_json({"notes": [note]})
    run_and_report(planned, out, workers, timeout_s)


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
    fidelity: FidelityOption = DEFAULT_FIDELITY,
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
    """Run what is missing and say what was found.

    What counts toward a campaign's answer is shown in that answer, on the terminal and on its page; Table I, beside the paper's
    numbers, and what does not count, on a page of its own.
    """
    from tuner.report.campaign_page import write_campaign_report

    plan, source = planned.plan, planned.source
    executor = local_pool(plan.fidelity, workers, timeout_s)
    taken = [rock for rock in plan.rocks if kind_on(rock, plan.fidelity).photographs == "taken"]
    not_counted = planned.not_counted(out)
    notes = (
        *planned.notes,
        *filter(None, [mission_kind(plan.fidelity).note, not_counted]),
        *map(_ceiling, taken),
    )
    planned = dataclasses.replace(planned, notes=notes)
    for note in notes:
        output.print(note, style="yellow")
    output.print(
        f"{counted(len(plan.strategies), 'strategy').replace('ys', 'ies')} on {counted(len(plan.rocks), 'target')}, "
        f"{counted(plan.replicates, 'replicate')} each{under_conditions(plan.conditions)}: "
        f"{plan.missions} missions, {counted(executor.capacity, 'worker')}"
    )
    note_dense_stage(mission_kind(plan.fidelity), next(iter(plan.strategies.values())))
    with executor:
        evaluated = run_with_progress(planned, executor, out)
    if source is None or not_counted:
        _report(planned, evaluated)
    else:
        answer = show_answer(source)
        answer_json(answer.to_dict())
        try:
            with working("writing the campaign's page"):
                output.print(f"page: {write_campaign_report(source, answer)}", soft_wrap=True)
        except UserError as error:  # of a campaign that may only be read
            output.print(f"its page stays as it was: {error}", highlight=False, soft_wrap=True)
    for reason, times in evaluated.failures.items():
        output.print(f"failed {times} times: {reason}", style="red")
    require_complete(evaluated)


def run_with_progress(
    planned: PlannedComparison, executor: Executor, out: Path | None = None
) -> EvaluationRun:
    """Run what is missing of a comparison, with a line for every mission."""
    with ComparisonProgress(planned.goal.shown.metric) as show:
        return planned.run(executor, show, out)


def _report(planned: PlannedComparison, evaluated: EvaluationRun) -> None:
    """Print the tables of one comparison, and write its page."""
    from tuner.report import comparison

    paper, facts = planned.source is None, comparison.ComparisonFacts(planned, evaluated)
    with working("writing the report"):
        report = comparison.write_comparison_report(facts, f"gatetune {shlex.join(sys.argv[1:])}")
    for line in comparison.verdict_lines(facts):
        output.print(line, style="bold")
    shown = comparison.result_tables(facts, narrow=output.width < 100)
    if paper and "whole" in facts.tables:  # no mission that has ended well, no table
        title = "Table I: completeness and distances on the whole surface"
        shown.append(comparison.table_i(facts.tables["whole"], title, paper=True, differences=False))
    for table in shown:
        output.print(*table.for_terminal())
    if paper:
        output.print(comparison.paper_note(planned.plan.fidelity))
    output.print(f"{duration(evaluated.elapsed_s)}; report: {report}")
    document = comparison.evaluation_document(facts)
    answer_json({"title": planned.title, "directory": report.parent, "report": report, **document})


def _ceiling(name: str) -> str:
    """The best score that a photograph set can show: that of one half of its photographs against the other."""
    from nbv.photographs.photograph_fidelity import ceiling

    halves = ceiling(PhotographSet.read(name))
    return (
        f"{name} is a set of photographs: 48 mm are 3 % of its height. The cloud of one half of its photographs, measured "
        f"against the other half's, has an F-score of {halves['f_score_48mm']:.1f} % and a completeness of "
        f"{halves['completeness_48mm']:.1f} %."
    )
