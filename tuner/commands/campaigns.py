"""``gatetune campaign list``: several campaigns beside one another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from nbv.errors import UserError
from tuner.commands.console import AsJson, answer_json, load, output
from tuner.problem.objective import objective_text
from tuner.problem.observations import short

if TYPE_CHECKING:
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
        answer = _answer(best)
    return {
        **row,
        "objective": _objective(campaign.settings),
        "finished": counts.finished,
        "budget": counts.budget,
        "values": None if best is None else best.values,
        "answer": answer,
    }


def _objective(settings: CampaignSettings) -> str:
    return objective_text(settings.objective, settings.second, settings.limit)


def _answer(best: Recommendation | None) -> str:
    """What to use, `NAMED` changes of it named."""
    if best is None:
        return "none yet: no mission has succeeded"
    if best.keep_default:
        return f"keep the default: {best.mean:.4g}"
    changes = ", ".join(f"{path} {short(best.values[path])}" for path in best.changed[:NAMED])
    more = f" and {len(best.changed) - NAMED} more" if len(best.changed) > NAMED else ""
    return f"{best.mean:.4g} in place of {best.default_mean:.4g}: {changes}{more}"
