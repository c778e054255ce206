"""``gatetune compare``: does a planner beat an orbit, and with how many photographs?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.rock_choice import rock_arguments
from tuner.commands.console import (
    LOADING_ROCKS,
    AsJson,
    ComparisonProgress,
    answer_json,
    load,
    local_executor,
    output,
    parse_overrides,
    require_complete,
    working,
)
from tuner.commands.options import Overrides, Timeout, Workers
from tuner.evaluation.run import run_evaluation
from tuner.problem.search_space import builtin

DEFAULT = ("hyb-h", "predicted", "random", "greedy-oracle", "orbit", "orbit-two", "orbit-by-height")


def compare(
    strategies: Annotated[
        list[str] | None,
        typer.Option(
            "--strategy",
            help="Baseline, scorer, gate or plug-in, repeatable; NAME-stopped ends when its predicted completeness is high enough "
            "(default: hyb-h, predicted, random, greedy-oracle and orbits).",
        ),
    ] = None,
    campaign: Annotated[
        Path | None, typer.Option(help="Run directory whose recommendation is added.")
    ] = None,
    suite: Annotated[
        str | None,
        typer.Option(help="Published settings, which no other option may change: rocks-1, shapes-1."),
    ] = None,
    targets: Annotated[int, typer.Option(help="Number of held-out rocks to draw.", min=1)] = 60,
    families: Annotated[
        list[str] | None,
        typer.Option("--family", help="Family to draw rocks from, repeatable (default: all six)."),
    ] = None,
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Rock, mesh file or photograph set in place of drawn rocks, repeatable."),
    ] = None,
    numbers: Annotated[
        str, typer.Option(help="Numbers of photographs: FIRST:LAST:STEP, or a list N,N,...")
    ] = "12:48:2",
    score: Annotated[
        float, typer.Option(help="F-score at 48 mm that a target must reach, in percent.")
    ] = 98.0,
    share: Annotated[float, typer.Option(help="Share of the targets that must reach it.")] = 0.75,
    against: Annotated[
        str | None,
        typer.Option(
            help="Strategy that the others are compared with (default: orbit-by-height, or the first)."
        ),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Replicates per target.", min=1)] = 1,
    fidelity: Annotated[
        str,
        typer.Option(help="curve: geometric missions; photogrammetric: with photographs, which takes hours."),
    ] = "curve",
    set_: Overrides = None,
    workers: Workers = None,
    timeout_s: Timeout = 600.0,
    out: Annotated[
        Path, typer.Option(help="Run directory; an interrupted comparison there is continued.")
    ] = Path("runs/compare"),
    as_json: AsJson = False,
) -> None:
    """Run strategies on unseen targets; report how many photographs each needs, with intervals, a figure and a page.

    Example: gatetune compare --strategy predicted --strategy random --strategy orbit-by-height --targets 12
    """
    output.print("comparing strategies")  # before what takes seconds to load
    load("tuner.evaluation.curves")
    from tuner.evaluation import curves
    from tuner.report.curves import share_table, write_comparison

    names = list(dict.fromkeys(strategies or DEFAULT))
    chosen: dict[str, MissionConfig | None] = dict.fromkeys(names)
    if suite is not None and suite not in curves.SUITES:
        raise UserError(f"there is no suite {suite!r}; there are {', '.join(curves.SUITES)}")
    if rocks:
        with working(LOADING_ROCKS):
            places = tuple(rock_arguments(rocks))
    else:
        places = curves.drawn_targets(targets, families or tuple(curves.FAMILIES))
    asked = curves.Suite(
        places,
        _numbers(numbers),
        replicates,
        score,
        share,
        fidelity,
        {**curves.BASE, **parse_overrides(set_ or [])},
    )
    if suite is not None and asked != curves.SUITES[suite]:
        published = curves.SUITES[suite].to_dict()
        changed = [name for name, value in asked.to_dict().items() if value != published[name]]
        raise UserError(
            f"these settings are not those of the suite {suite} ({', '.join(changed)}); remove --suite, or the options that change it"
        )
    if campaign is not None:
        chosen["tuned"] = builtin(Campaign.open(campaign, read_only=True).recommended_config())
    reference = against or (curves.BY_HEIGHT if curves.BY_HEIGHT in chosen else next(iter(chosen)))
    if reference not in chosen:
        raise UserError(f"--against {reference} is not among the strategies {', '.join(chosen)}")
    plan = curves.comparison_plan(asked, chosen)
    if rocks or families or set_:  # else the targets and views fit
        with working("looking at the targets"):
            curves.require_room(places, asked.base)
    executor = local_executor(fidelity, workers, timeout_s)
    output.print(f"{asked.name}: {len(chosen)} strategies on {len(places)} targets, {plan.missions} missions")
    with executor, ComparisonProgress("observable.f_score_48mm") as show:
        run = run_evaluation(plan, out, executor, show)
    require_complete(run)
    with working("drawing"):
        document = write_comparison(asked, list(chosen), reference, run.records, out)
    output.print(*share_table(document).for_terminal(output.width))
    output.print(document["verdict"], style="bold")
    if document["score_0"]:
        output.print("These missions count with a score of 0:", style="red")
    for said in document["score_0"]:
        output.print(f"- {said}")
    output.print(f"report: {out / 'report.html'}")
    answer_json(document)


def _numbers(text: str) -> tuple[int, ...]:
    try:
        if ":" in text:
            first, last, step = (int(part) for part in text.split(":"))
            return tuple(range(first, last + 1, step))
        return tuple(int(part) for part in text.split(","))
    except ValueError as error:
        raise UserError(f"--numbers {text!r} must be FIRST:LAST:STEP or N,N,...") from error
