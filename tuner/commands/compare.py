"""``gatetune compare``: does a planner beat an orbit, and with how many photographs?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.config import IDEAL, IDEAL_CONDITION, Condition, MissionConfig, load_condition
from nbv.errors import UserError
from nbv.safe_files import is_file
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
    suite: Annotated[
        str | None,
        typer.Option(help="Published settings, which no other option may change: rocks-1, shapes-1."),
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
            help="Rock, mesh file or photograph set in place of drawn rocks, or one under a condition of its own as "
            "ROCK@CONDITION, repeatable.",
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
    from tuner.report.curves import answer_table, write_curves, zero_text

    names = list(dict.fromkeys(strategies or DEFAULT))
    chosen: dict[str, MissionConfig | None] = dict.fromkeys(names)
    if suite is not None and suite not in curves.SUITES:
        raise UserError(f"there is no suite {suite!r}; there are {', '.join(curves.SUITES)}")
    everywhere = tuple(map(_condition, conditions or [IDEAL]))
    if rocks:
        with working(LOADING_ROCKS):
            places, under = _places(rocks, everywhere)
    else:
        drawn = curves.drawn_targets(targets, families or tuple(curves.FAMILIES))
        if suite is not None and not families and targets == TARGETS:
            drawn = curves.SUITES[suite].targets
        places, under = tuple(Instance(t.rock, c.name) for c in everywhere for t in drawn), everywhere
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
    if suite is not None and requested != curves.SUITES[suite]:
        published = curves.SUITES[suite].to_dict()
        changed = [name for name, value in requested.to_dict().items() if value != published[name]]
        raise UserError(
            f"these settings are not those of the suite {suite} ({', '.join(changed)}); remove --suite, or the options that change it"
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
    plans = curves.comparison_plans(requested, chosen)
    if rocks or families or set_ or conditions:  # else the targets and views fit
        with working("looking at the targets"):
            curves.require_room(requested)
    if conditions and (note := mission_kind(fidelity).note):
        output.print(note, style="yellow")
    missions = sum(plan.missions for plan in plans.values())
    output.print(
        f"{requested.name}: {len(chosen)} strategies on {len(places)} targets{under_conditions(under)}, {missions} missions"
    )
    if seeds := requested.base.seeds:
        last = requested.numbers[-1]
        output.print(
            f"planners begin with {seeds} seeds and plan the rest: {last} photographs are {seeds} + {last - seeds}"
        )
    longest = curves.ending_at(requested.base, requested.numbers[-1])
    for kind in dict.fromkeys(kind_on(place.rock, fidelity) for place in places):
        note_dense_stage(kind, longest)
    runs = run_plans(plans, out, workers, timeout_s, DEFAULT_METRIC)
    records = [trial for run in runs for trial in run.records]
    with working("drawing"):
        series = curves.all_series(requested, list(chosen), records)
        outcome = curves.outcome(requested, series, reference)
        document = write_curves(requested, series, outcome, out)
    output.print(*answer_table(requested, outcome).for_terminal())
    output.print(" ".join(document["verdict"]), style="bold")
    if outcome.score_0:
        output.print("These missions count with a score of 0:", style="red")
    for zero in outcome.score_0:
        output.print(f"- {zero_text(zero, len(places))}")
    output.print(f"report: {out / 'report.html'}")
    answer_json(document)


def _places(
    rocks: list[str], everywhere: tuple[Condition, ...]
) -> tuple[tuple[Instance, ...], tuple[Condition, ...]]:
    """Every rock under its own condition, of ROCK@CONDITION, or else ``everywhere``; and the conditions."""
    split = [(rock, "") if is_file(Path(rock)) else rock.partition("@")[::2] for rock in rocks]
    places, used = list[Instance](), list[Condition]()
    for (_, condition_name), rock in zip(split, rock_arguments([name for name, _ in split])):
        for condition in (_condition(condition_name),) if condition_name else everywhere:
            places.append(Instance(rock, condition.name))
            used += [condition] if condition not in used else []
    return tuple(places), tuple(used)


def _condition(name: str) -> Condition:
    return IDEAL_CONDITION if name == IDEAL else load_condition(name)  # without its file's description


def _numbers(text: str) -> tuple[int, ...]:
    try:
        if ":" in text:
            first, last, step = (int(part) for part in text.split(":"))
            return tuple(range(first, last + 1, step))
        return tuple(int(part) for part in text.split(","))
    except ValueError as error:
        raise UserError(f"--numbers {text!r} must be FIRST:LAST:STEP or N,N,...") from error
