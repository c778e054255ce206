"""``gatetune evaluate`` and ``gatetune confirm``: job 2."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nbv.config import load_conditions
from nbv.errors import UserError
from tuner.commands.comparison import compare
from tuner.commands.console import AsJson, answer_json, load, output, working
from tuner.commands.options import Conditions, Fidelity, MissionAllowed, Rocks, Timeout, Workers
from tuner.missions.registry import DEFAULT_FIDELITY

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign


MarginOption = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Of a campaign with a limit: quality that may be lost and still counts as kept, in the metric's unit.",
    ),
]


def evaluate(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: Rocks = None,
    conditions: Conditions = None,
    replicates: Annotated[int, typer.Option(help="Per rock, the same for all strategies.")] = 3,
    strategies: Annotated[
        list[str] | None,
        typer.Option(
            "--against",
            help="Baseline, repeatable (default: the paper's four, learned, matchable, random, greedy-oracle, orbit, orbit-two; "
            "where the target has to be looked for orbit-reaimed and orbit-two-reaimed, too).",
        ),
    ] = None,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    margin: MarginOption = 1.0,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/evaluation).")] = None,
    mission: MissionAllowed = None,
    as_json: AsJson = False,
) -> None:
    """Fly the recommended configuration and the baselines on held-out rocks; print Table I with intervals.

    Example: gatetune evaluate runs/mine --replicates 3
    """
    output.print(f"evaluating the recommendation of {campaign}")  # before what takes seconds to load
    load("tuner.evaluation.of_campaign")
    from tuner.evaluation.of_campaign import held_out

    source = _open(campaign, mission, fidelity)
    asked = held_out(
        source,
        rocks=rocks,
        replicates=replicates,
        strategies=strategies,
        conditions=load_conditions(conditions) if conditions else None,
        margin=margin,
        fidelity=fidelity,
        making=working,
    )
    compare(
        asked,
        campaign / "evaluation",
        out,
        workers=workers,
        timeout_s=timeout_s,
        title=f"{source.settings.name}: tuned against baselines on held-out {asked.asked.place}s",
        mission=source.settings.mission,
    )


def confirm(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    rocks: Rocks = None,
    replicates: Annotated[int, typer.Option(help="Per rock, none of them flown by the campaign.")] = 4,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    margin: MarginOption = 1.0,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/confirmation).")] = None,
    mission: MissionAllowed = None,
    as_json: AsJson = False,
) -> None:
    """Fly the recommendation, the default and plain orbits on training rocks with fresh replicates; say whether the rocks gained.

    Example: gatetune confirm runs/mine --rock mine
    """
    output.print(f"confirming the recommendation of {campaign}")  # before what takes seconds to load
    load("tuner.evaluation.of_campaign")
    from tuner.evaluation.of_campaign import confirmation

    source = _open(campaign, mission, fidelity)
    asked = confirmation(source, rocks=rocks, replicates=replicates, margin=margin, fidelity=fidelity)
    if asked is None:
        note = f"{campaign} recommends to keep the default: there is nothing to confirm"
        output.print(note)
        return answer_json({"notes": [note]})
    compare(
        asked,
        campaign / "confirmation",
        out,
        workers=workers,
        timeout_s=timeout_s,
        title=f"{source.settings.name}: the recommendation against the default on training {asked.asked.place}s, fresh replicates",
        mission=source.settings.mission,
    )


def _open(directory: Path, mission: Path | None, fidelity: str) -> Campaign:
    from tuner.campaign.campaign import Campaign

    source = Campaign.open(directory, read_only=True, mission=mission)
    source.allow_program(named=mission is not None)
    if source.settings.mission is not None and fidelity != DEFAULT_FIDELITY:
        raise UserError("--fidelity is of our own missions; a mission file says itself how it flies")
    return source
