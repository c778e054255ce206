"""``gatetune compare``: does a planner beat an orbit, and with how many photographs?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.config import IDEAL, IDEAL_CONDITION, MissionConfig, load_condition
from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.mission_problem import rock_arguments
from tuner.commands.console import (
    CONDITION_HELP,
    LOADING_ROCKS,
    AsJson,
    answer_json,
    load,
    note_dense_stage,
    output,
    parse_overrides,
    run_plans,
    under_conditions,
    working,
)
from tuner.commands.options import Overrides, Timeout, Workers
from tuner.missions.registry import kind_on, mission_kind
from tuner.problem.baselines import is_orbit
from tuner.problem.goal import DEFAULT_METRIC
from tuner.problem.instances import Instance

TARGETS = 60
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
    targets: Annotated[int, typer.Option(help="Number of held-out rocks to draw.", min=1)] = TARGETS,
    families: Annotated[
        list[str] | None,
        typer.Option("--family", help="Family to draw rocks from, repeatable (default: all six)."),
    ] = None,
    rocks: Annotated[
        list[str] | None,
        typer.Option(
            "--rock",
            help="Rock, mesh file or photograph set in place of drawn rocks, repeatable.",
        ),
    ] = None,
    conditions: Annotated[
        list[str] | None,
        typer.Option("--condition", help=f"{CONDITION_HELP[:-1]}, repeatable (default: ideal)."),
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
            help="Strategy that the others are compared with (default: orbit-by-height, or the first orbit)."
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
    load("tuner.comparison.curves")
    from tuner.comparison import curves
    from tuner.report.curves import answer_table, failed_lines, write_curves

    names = list(dict.fromkeys(strategies or DEFAULT))
    chosen: dict[str, MissionConfig | None] = dict.fromkeys(names)
    # The ideal one without its file's description.
    under = tuple(IDEAL_CONDITION if c == IDEAL else load_condition(c) for c in conditions or [IDEAL])
    if rocks:
        with working(LOADING_ROCKS):
            named = rock_arguments(rocks)
    else:
        named = [t.rock for t in curves.drawn_targets(targets, families or tuple(curves.FAMILIES))]
    places = tuple(Instance(rock, condition.name) for condition in under for rock in named)
    requested = curves.Suite(
        places,
        _numbers(numbers),
        replicates,
        score,
        share,
        fidelity,
        {**curves.BASE, **parse_overrides(set_ or [])},
        under,
    )
    if campaign is not None:
        chosen["tuned"] = Campaign.open(campaign, read_only=True).recommended_config()
    if against is None and fidelity == curves.CURVE and not any(map(is_orbit, chosen)):
        chosen[curves.BY_HEIGHT] = None  # the control that everything is measured from
    orbits = [
        name
        for name in (curves.BY_HEIGHT, *chosen)
        if name in chosen and (name == curves.BY_HEIGHT or is_orbit(name))
    ]
    reference = against or next(iter([*orbits, *chosen]))
    if reference not in chosen:
        raise UserError(f"--against {reference} is not among the strategies {', '.join(chosen)}")
    plan = curves.comparison_plan(requested, chosen)
    if rocks or families or set_ or conditions:  # else the targets and views fit
        with working("looking at the targets"):
            curves.require_room(requested)
    if conditions and (note := mission_kind(fidelity).note):
        output.print(note, style="yellow")
    output.print(
        f"{requested.name}: {len(chosen)} strategies on {len(places)} targets{under_conditions(under)}, {plan.missions} missions"
    )
    if seeds := requested.base.seeds:
        last = requested.numbers[-1]
        output.print(
            f"planners begin with {seeds} seeds and plan the rest: {last} photographs are {seeds} + {last - seeds}"
        )
    longest = curves.ending_at(requested.base, requested.numbers[-1])
    for kind in dict.fromkeys(kind_on(place.rock, fidelity) for place in places):
        note_dense_stage(kind, longest)
    (run,) = run_plans({"": plan}, out, workers, timeout_s, DEFAULT_METRIC)
    with working("drawing"):
        series = curves.all_series(requested, list(chosen), run.records)
        outcome = curves.outcome(requested, series, reference)
        document = write_curves(requested, series, outcome, out)
    output.print(*answer_table(requested, outcome).for_terminal())
    output.print(" ".join(document["verdict"]), style="bold")
    for line in failed_lines(series):
        output.print(f"counted with a score of 0: {line}", style="red", highlight=False)
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
