"""``gatetune export``: the recommendation as files for the vehicle, the missions as a table."""

from __future__ import annotations

import functools
import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.foreign import RESULT_BYTES, RESULT_NODES, read_json, read_yaml
from nbv.mission.run_directory import write_atomic
from tuner.commands.console import load, output, working

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.recommendation.recommendation import Recommendation

TABLES = ("csv", "json", "parquet")


class Format(StrEnum):
    """What can be written."""

    scoring = "scoring.yaml"
    mission = "unified_mission.yaml"
    ours = "gatetune.yaml"
    plan = "plan"
    csv = "csv"
    json = "json"
    parquet = "parquet"
    optuna = "optuna"


def export(
    run: Annotated[Path, typer.Argument(help="A campaign's run directory; for plan a mission's, too.")],
    to: Annotated[
        Format | None,
        typer.Option(
            help="scoring.yaml and unified_mission.yaml are the authors' files; plan is QGroundControl's; csv, json and parquet "
            "hold a row per mission of a campaign or an evaluation; optuna is a folder for optuna-dashboard. "
            "Without it: what each file would carry."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write (default: in RUN, under its usual name).")
    ] = None,
    onto: Annotated[
        Path | None,
        typer.Option(help="A file of the authors' kind whose other keys are kept (default: as published)."),
    ] = None,
    home: Annotated[
        str | None, typer.Option(help="For plan: LATITUDE,LONGITUDE[,ALTITUDE] of take-off.")
    ] = None,
) -> None:
    """Write the recommendation as a file whose header says which changes it carries, or the missions as a table.

    Example: gatetune export runs/mine, then gatetune export runs/mine --to unified_mission.yaml
    """
    if (to is Format.plan) != (home is not None):
        raise UserError("--home LATITUDE,LONGITUDE belongs to --to plan, and plan needs it")
    what = to.value if to else "the recommendation"
    output.print(f"exporting {what} of {run}", soft_wrap=True)  # before what takes seconds to load
    if to is None:
        return _list_files(run)
    if to.value in TABLES:
        from tuner.report.records import write_records

        written = write_records(_missions(run), out or run / f"missions.{to.value}", to.value)
        output.print(f"wrote {written}", markup=False, soft_wrap=True)
        return
    if to is not Format.plan:
        load("tuner.campaign.campaign")
    if to is Format.optuna:
        from tuner.campaign.campaign import Campaign
        from tuner.report.dashboard import write_dashboard

        with working("writing the study and its artefacts"):
            files = write_dashboard(Campaign.open(run, read_only=True), out or run / "dashboard")
        output.print(f"wrote {files.journal}; look at it: {files.command}", markup=False, soft_wrap=True)
        return
    path = out or run / ("route.plan" if to is Format.plan else to.value)
    text, remarks = _plan(run, str(home)) if to is Format.plan else _yaml(run, to, onto)
    if not path.parent.is_dir():
        raise UserError(f"{path.parent} is no folder; make it first")
    write_atomic(path, text)
    output.print(f"wrote {path}", markup=False, soft_wrap=True)
    for remark in remarks:
        output.print(remark, markup=False, highlight=False, soft_wrap=True)


def _missions(run: Path) -> Any:
    """The campaign, or the evaluation, in ``run``."""
    from tuner.campaign.campaign import Campaign
    from tuner.evaluation.flying import EvaluationRun
    from tuner.evaluation.plan import PLAN_FILE, EvaluationPlan

    if not (run / PLAN_FILE).is_file():
        return Campaign.open(run, read_only=True)
    plan = EvaluationPlan.load(run)
    return EvaluationRun(plan, plan.records(run), complete=True, elapsed_s=0.0)


def _recommended(run: Path) -> tuple[Campaign, Recommendation]:
    from tuner.campaign.campaign import Campaign

    campaign = Campaign.open(run, read_only=True)
    best = campaign.recommendation(save=False)
    if best is None:
        raise UserError(f"{run} has no successful mission yet; run or resume the campaign first")
    return campaign, best


def _list_files(run: Path) -> None:
    """Which file carries how much, and the command that writes the first."""
    from tuner.report.campaign.vehicle_files import change_text, share_text, vehicle_files

    campaign, best = _recommended(run)
    say = functools.partial(output.print, markup=False, highlight=False, soft_wrap=True)
    say(f"recommended: {', '.join(change_text(best, p) for p in best.changed) or 'keep the default'}")
    names = [Format.ours.value]
    if _for_vehicles(campaign):
        files = vehicle_files(campaign, best)
        for file in files:
            say(f"{file.name} carries {file.share}")
        names = [file.name for file in files if file.useful] + names
    say(f"{Format.ours.value} carries {share_text(len(best.changed))}; it is gatetune's own file")
    say(f"write the first: gatetune export {run} --to {names[0]}")


def _for_vehicles(campaign: Campaign) -> bool:
    """Whether the missions are ours or the authors', so that their files can be written."""
    from tuner.bridges.photogrammetry_nbv import FUNCTION

    mission = campaign.settings.mission
    return mission is None or mission.function == FUNCTION


def _yaml(run: Path, to: Format, onto: Path | None) -> tuple[str, list[str]]:
    from tuner.problem.search_space import ours
    from tuner.report.campaign.vehicle_files import header, share_text, vehicle_files

    campaign, best = _recommended(run)
    if to is not Format.ours:
        files = vehicle_files(campaign, best, {to.value: onto} if onto else None)
        (file,) = (file for file in files if file.name == to.value)
        if not file.useful:
            other = next((f.name for f in files if f.useful), Format.ours.value)
            raise UserError(
                f"{to.value} carries none of the changes ({', '.join(file.lost)}); "
                f"run: gatetune export {run} --to {other}"
            )
        said = [f"it carries {file.share}"]
        return file.text, [*said, *(f"does not transfer: {text}" for text in file.remarks)]
    from tuner.commands.config import commented_yaml
    from tuner.missions.external import ExternalConfig

    config = campaign.settings.config(best.values)
    if isinstance(config, ExternalConfig):
        lines = yaml.safe_dump(dict(config.values), sort_keys=False).splitlines()
    else:
        lines = commented_yaml(ours(config))
    comment = [f"# {line}" for line in header(campaign, best, best.changed)]
    return "\n".join([*comment, *lines]) + "\n", [f"it carries {share_text(len(best.changed))}"]


def _plan(run: Path, home: str) -> tuple[str, list[str]]:
    from tuner.bridges import Home, qgc_plan
    from tuner.report.campaign.shown import RECOMMENDED

    try:
        numbers = [float(part) for part in home.split(",")]
        place = Home(*numbers)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"--home {home!r} is not LATITUDE,LONGITUDE[,ALTITUDE] in degrees and metres"
        ) from error
    shown = run / RECOMMENDED
    config, views = _flown(shown if shown.is_dir() else run)
    seeds = sum(name.startswith("seed_") for name in views)
    said = [
        f"it carries the route of {shown if shown.is_dir() else run}: {len(views)} photographs ({seeds} seeds, then "
        f"{len(views) - seeds} that the planner chose there), none planned above {config.pool.max_altitude_m:g} m",
        "it does not carry the gate: a fixed route repeats these views and plans nothing in the air",
    ]
    return json.dumps(qgc_plan(config, views, place), indent=1) + "\n", said


def _flown(run: Path) -> tuple[MissionConfig, list[str]]:
    try:
        flight = read_json(run / "flight.json", RESULT_BYTES, RESULT_NODES)
        config = config_from_dict(read_yaml(run / "config.yaml"))
        names = [event["name"] for event in flight["events"]]
    except (UserError, KeyError, TypeError) as error:
        raise UserError(
            f"{run} is no mission with its flight; name one that was kept whole (gatetune mission run, or --keep all)"
        ) from error
    return config, [name for name in names if name.startswith(("seed_", "cand_"))]
