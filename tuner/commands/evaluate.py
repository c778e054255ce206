"""``gatetune evaluate``: job 2."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nbv.config import IDEAL, Condition, load_conditions
from nbv.errors import UserError
from tuner.commands.comparison import compare
from tuner.commands.console import MISSION_HELP, load, output, working

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.settings import CampaignSettings
    from tuner.evaluation.plan import EvaluationPlan
    from tuner.report.comparison.verdicts import LimitAsked


LONGEST_NAME = 100  # characters of a folder's name

MarginOption = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Of a campaign with a limit: quality that may be lost and still counts as kept, in the metric's unit.",
    ),
]


def evaluate(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Held-out rock, repeatable (default: the procedural ones)."),
    ] = None,
    conditions: Annotated[
        list[str] | None,
        typer.Option(
            "--condition",
            help="World to fly the rocks in, a name of conditions/ or a YAML file; repeatable (default: the campaign's).",
        ),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Per rock, the same for all strategies.")] = 3,
    strategies: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            help="Baseline, repeatable (default: the paper's four, learned, matchable, random, greedy-oracle).",
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Paired differences are against this strategy (default: hyb-h; of a mission file default)."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    margin: MarginOption = 1.0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/evaluation).")] = None,
    mission: Annotated[Path | None, typer.Option(help=MISSION_HELP)] = None,
) -> None:
    """Fly the recommended configuration and the baselines on held-out rocks; print Table I with intervals.

    Example: gatetune evaluate runs/mine --replicates 3
    """
    output.print(f"evaluating the recommendation of {campaign}")  # before what takes seconds to load
    load("tuner.campaign.campaign")
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.rock_choice import unseen_rocks
    from tuner.evaluation.baselines import (
        EVALUATION_BASELINES,
        at_equal_number,
        baseline_configs,
        tuned_configs,
    )
    from tuner.evaluation.plan import EvaluationPlan
    from tuner.problem.search_space import ours

    source = Campaign.open(campaign, read_only=True, mission=mission)
    source.allow_program(named=mission is not None)
    if source.settings.mission is not None:
        if conditions:
            raise UserError("--condition is of our own missions; a mission file has instances")
        plan, against = _of_mission_file(source, rocks, replicates, strategies, reference)
        compare(
            plan,
            out or campaign / "evaluation",
            workers=workers,
            timeout_s=timeout_s,
            objective=source.settings.objective,
            reference=against,
            title=f"{source.settings.name}: tuned against baselines on held-out instances",
            paper=False,
            mission=source.settings.mission,
            asked=_asked(source.settings, margin),
        )
        return
    worlds = load_conditions(conditions) if conditions else source.settings.conditions
    dataclasses.replace(source.settings, conditions=worlds)  # says where the two contradict each other
    _say_what_is_unseen(source, worlds)
    chosen = unseen_rocks(source, rocks, working)
    base = ours(source.settings.base_config())
    configs = baseline_configs(list(strategies or EVALUATION_BASELINES), base)
    reference = reference or "hyb-h"
    if reference not in configs:
        raise UserError(f"--reference {reference!r} is not evaluated; choose from {', '.join(configs)}")
    recommended = ours(source.recommended_config())
    if recommended.digest() == base.digest():
        output.print("the campaign recommends to keep the default: Tuned is the default")
    tuned = tuned_configs(recommended, base)
    plan = EvaluationPlan(
        {**tuned, **at_equal_number(configs, recommended, reference)}, chosen, replicates, conditions=worlds
    )
    compare(
        plan,
        out or campaign / "evaluation",
        workers=workers,
        timeout_s=timeout_s,
        objective=source.settings.objective,
        reference=reference,
        title=f"{source.settings.name}: tuned against baselines on held-out rocks",
        paper=False,
        asked=_asked(source.settings, margin),
    )


def confirm(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Training rock, repeatable (default: all of the campaign's)."),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Per rock, none of them flown by the campaign.")] = 4,
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    margin: MarginOption = 1.0,
    out: Annotated[
        Path | None, typer.Option(help="Directory (default: CAMPAIGN/confirmation-ROCKS).")
    ] = None,
    mission: Annotated[Path | None, typer.Option(help=MISSION_HELP)] = None,
) -> None:
    """Fly the recommendation and the default on training rocks with fresh replicates; say whether the rocks gained.

    Example: gatetune confirm runs/mine --rock mine
    """
    output.print(f"confirming the recommendation of {campaign}")  # before what takes seconds to load
    load("tuner.campaign.campaign")
    from tuner.campaign.campaign import Campaign
    from tuner.evaluation.baselines import TUNED
    from tuner.evaluation.plan import EvaluationPlan
    from tuner.missions.registry import DEFAULT_FIDELITY

    source = Campaign.open(campaign, read_only=True, mission=mission)
    source.allow_program(named=mission is not None)
    s = source.settings
    known = {rock if s.mission is not None else Path(rock).stem: rock for rock in s.rocks}
    chosen = [rock if rock in s.rocks else known.get(Path(rock).stem, rock) for rock in rocks or s.rocks]
    for rock in chosen:
        if rock not in s.rocks:
            raise UserError(
                f"{campaign} was not tuned on {rock!r}; name one of {', '.join(known)}, or use evaluate"
            )
    tuned, default = source.recommended_config(), s.config(s.default_values())
    if tuned.digest() == default.digest():
        output.print(f"{campaign} recommends to keep the default: there is nothing to confirm")
        return
    plan = EvaluationPlan(
        {TUNED: tuned, "default": default},
        tuple(chosen),
        replicates,
        first_replicate=s.replicates,
        fidelity=s.fidelity if s.mission is not None else DEFAULT_FIDELITY,
        conditions=s.conditions,
    )
    names = "-".join(re.sub(r"[^\w.-]", "-", name) for name, rock in known.items() if rock in chosen)
    if len(names) > LONGEST_NAME:
        names = f"{len(chosen)}-rocks"
    compare(
        plan,
        out or campaign / f"confirmation-{names}",
        workers=workers,
        timeout_s=timeout_s,
        objective=s.objective,
        reference="default",
        title=f"{s.name}: the recommendation against the default on training rocks, fresh replicates",
        paper=False,
        mission=s.mission,
        asked=_asked(s, margin),
    )


def _asked(settings: CampaignSettings, margin: float) -> LimitAsked | None:
    """The limit that the campaign was given; None where it has none."""
    from tuner.report.comparison.verdicts import LimitAsked

    if settings.second is None or settings.limit is None:
        return None
    return LimitAsked(settings.objective, settings.second, settings.limit, margin)


def _say_what_is_unseen(campaign: Campaign, conditions: Sequence[Condition]) -> None:
    """Which conditions the campaign, and those that it learned from, have flown under."""
    flown = {condition.name for condition in campaign.settings.conditions}
    if campaign.learned is not None:
        flown |= {o.condition for o in campaign.learned.observations}
    names = [condition.name for condition in conditions]
    unseen = [name for name in names if name not in flown]
    if unseen:
        output.print(f"conditions that the campaign has not seen: {', '.join(unseen)}")
    if (seen := [name for name in names if name in flown]) and names != [IDEAL]:
        output.print(f"tuned under, so no test of transfer: {', '.join(seen)}", style="yellow")


def _of_mission_file(
    source: Campaign,
    rocks: list[str] | None,
    replicates: int,
    strategies: list[str] | None,
    reference: str | None,
) -> tuple[EvaluationPlan, str]:
    """What a mission file says to evaluate: tuned, its defaults and its baselines on its held-out instances."""
    from tuner.evaluation.baselines import TUNED
    from tuner.evaluation.plan import EvaluationPlan
    from tuner.missions.external import external_config
    from tuner.missions.registry import EXTERNAL

    mission = source.settings.mission
    assert mission is not None
    held_out = [instance.name for instance in mission.held_out]
    if not held_out:
        raise UserError(f"{mission.path} holds nothing out; name instances under held_out")
    for rock in rocks or ():
        if rock not in held_out:
            raise UserError(f"{rock!r} is not held out; {mission.path} holds out {', '.join(held_out)}")
    known = {"default": {}, **mission.baselines}
    for name in strategies or ():
        if name not in known:
            raise UserError(f"{mission.path} has no baseline {name!r}; there are {', '.join(known)}")
    configs = {name: external_config(mission, known[name]) for name in strategies or known}
    reference = reference or next(iter(configs))
    if reference not in configs:
        raise UserError(f"--reference {reference!r} is not evaluated; choose from {', '.join(configs)}")
    flown = {TUNED: source.recommended_config(), **configs}
    return EvaluationPlan(flown, tuple(rocks or held_out), replicates, fidelity=EXTERNAL), reference
