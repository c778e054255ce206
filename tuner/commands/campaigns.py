"""``gatetune campaign list|compare``: several campaigns beside one another."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from nbv.config import parameters
from nbv.errors import UserError
from tuner.commands.console import AsJson, answer_json, load, output
from tuner.problem.configurations import short
from tuner.problem.quality_at_cost import objective_text

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.settings import CampaignSettings
    from tuner.recommendation.recommendation import Recommendation


NAMED = 2  # changes in a line of the list


def list_(
    folder: Annotated[Path, typer.Argument(help="Whose folders are looked into.")] = Path("runs"),
    as_json: AsJson = False,
) -> None:
    """The campaigns in a folder: what each is tuned for, how far it is, its answer in a line.

    Example: gatetune campaign list
    """
    from tuner.campaign.settings_file import SETTINGS_FILE

    found = sorted(path.parent for path in folder.glob(f"*/{SETTINGS_FILE}"))
    if not found:
        raise UserError(
            f"{folder} holds no campaign; begin one: gatetune campaign run, or name another folder"
        )
    load("tuner.campaign.campaign")
    rows = [_row(directory) for directory in found]
    table = Table()
    for column in ("campaign", "tuned for", "missions", "answer"):
        table.add_column(column, justify="right" if column == "missions" else "left")
    for row in rows:
        table.add_row(
            row["directory"], row["objective"] or "", f"{row['finished']}/{row['budget']}", row["answer"]
        )
    output.print(table)
    answer_json(rows)


def _row(directory: Path) -> dict[str, Any]:
    """A campaign in a line; of one that cannot be read, why."""
    from tuner.campaign.campaign import Campaign

    row: dict[str, Any] = {"directory": str(directory), "objective": None, "finished": None, "budget": None}
    try:
        campaign = Campaign.open(directory, read_only=True)
        counts, best = campaign.status(), campaign.saved_recommendation()
    except UserError as error:
        return {**row, "values": None, "answer": f"cannot be read: {error}"}
    if best is None and counts.complete:
        answer = f"not worked out yet: gatetune campaign status {directory}"
    else:
        answer = _answer(best, NAMED)
    return {
        **row,
        "objective": _objective(campaign.settings),
        "finished": counts.finished,
        "budget": counts.budget,
        "values": None if best is None else best.values,
        "answer": answer,
    }


def compare(
    first: Annotated[Path, typer.Argument(help="A campaign's run directory.")],
    second: Annotated[Path, typer.Argument(help="Another's.")],
    as_json: AsJson = False,
) -> None:
    """Two campaigns: their answers, and which values differ between what they recommend.

    Example: gatetune campaign compare runs/mine runs/first
    """
    load("tuner.campaign.campaign")
    from tuner.campaign.campaign import Campaign

    both = [Campaign.open(directory, read_only=True) for directory in (first, second)]
    found = [campaign.recommendation(save=False) for campaign in both]
    differ = _not_the_same(both)
    for campaign, best in zip(both, found):
        s, counts = campaign.settings, campaign.status()
        output.print(
            f"{campaign.directory}: {_objective(s)} on {_rocks(s)}, {s.fidelity}, {counts.finished} of "
            f"{counts.budget} missions: {_answer(best)}",
            highlight=False,
            soft_wrap=True,
        )
    values = _values(both, found)
    changed = {path: pair for path, pair in values.items() if pair[0] != pair[1]}
    table = Table(title="Values that differ")
    table.add_column("parameter")
    for campaign in both:
        table.add_column(str(campaign.directory), justify="right")
    for path, pair in changed.items():
        table.add_row(path, *("not set" if value is None else short(value) for value in pair))
    output.print(table if changed else "both would fly the same configuration")
    if differ:
        said = f"Their scores cannot be set against each other: {'; '.join(differ)}."
    else:
        said = "Both are tuned for the same on the same rocks; gatetune evaluate measures each on rocks that neither has seen."
    output.print(said, highlight=False, soft_wrap=True)
    answer_json(
        {
            "comparable": not differ,
            "differences": differ,
            "campaigns": [
                {
                    "directory": campaign.directory,
                    "objective": _objective(campaign.settings),
                    "rocks": campaign.settings.rocks,
                    "fidelity": campaign.settings.fidelity,
                    "status": campaign.status(),
                    "recommendation": best,
                }
                for campaign, best in zip(both, found)
            ],
            "values": changed,
        }
    )


def _not_the_same(both: list[Campaign]) -> list[str]:
    """Why what two campaigns have reached is not the same quantity: in words, nothing where it is."""
    a, b = (campaign.settings for campaign in both)
    pairs = {
        "tuned for": (_objective(a), _objective(b)),
        "rocks": (_rocks(a), _rocks(b)),
        "conditions": (", ".join(c.name for c in a.conditions), ", ".join(c.name for c in b.conditions)),
        "fidelity": (a.fidelity, b.fidelity),
        "mission file": (a.mission and a.mission.sha256[:12], b.mission and b.mission.sha256[:12]),
    }
    return [f"{what} {one} and {other}" for what, (one, other) in pairs.items() if one != other]


def _objective(settings: CampaignSettings) -> str:
    return objective_text(settings.objective, settings.second, settings.limit)


def _rocks(settings: CampaignSettings) -> str:
    return ", ".join(Path(rock).stem for rock in settings.rocks)


def _answer(best: Recommendation | None, most: int | None = None) -> str:
    """What to use, ``most`` changes of it named."""
    if best is None:
        return "none yet: no mission has succeeded"
    if best.keep_default:
        return f"keep the default: {best.mean:.4g}"
    changes = ", ".join(f"{path} {short(best.values[path])}" for path in best.changed[:most])
    more = f" and {len(best.changed) - most} more" if most and len(best.changed) > most else ""
    return f"{best.mean:.4g} in place of {best.default_mean:.4g}: {changes}{more}"


def _values(both: list[Campaign], found: list[Recommendation | None]) -> dict[str, tuple[Any, Any]]:
    """By path what each would fly, the whole configuration; None where it has no such parameter or no answer."""
    one, other = ({} if best is None else _flat(campaign, best) for campaign, best in zip(both, found))
    paths = [path for path in {**one, **other} if path not in ("preset", "condition")]
    return {path: (one.get(path), other.get(path)) for path in paths}


def _flat(campaign: Campaign, best: Recommendation) -> dict[str, Any]:
    from tuner.missions.external import ExternalConfig
    from tuner.problem.search_space import ours

    config = campaign.settings.config(best.values)
    if isinstance(config, ExternalConfig):
        return dict(config.values)
    return {path: attrgetter(path)(ours(config)) for path in parameters()}
