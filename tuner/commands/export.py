"""``gatetune export``: the recommendation as files for the vehicle, the missions as a table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, read_json, read_yaml
from tuner.commands.console import AsJson, answer_json, load, output

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.recommendation.recommendation import Recommendation
    from tuner.report.vehicle_files import VehicleFile

OURS = "gatetune.yaml"


class Format(StrEnum):
    """What can be written."""

    scoring = "scoring.yaml"
    mission = "unified_mission.yaml"
    ours = OURS
    plan = "plan"
    csv = "csv"


def export(
    run: Annotated[Path, typer.Argument(help="A campaign's run directory; for plan a mission's, too.")],
    to: Annotated[
        Format | None,
        typer.Option(
            help="scoring.yaml and unified_mission.yaml are the authors' files; plan is QGroundControl's; csv has a row per "
            "mission of a campaign or an evaluation. Without it: what each file would carry."
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
    as_json: AsJson = False,
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
    if to is Format.csv:
        from tuner.report.records import write_csv

        return _wrote(write_csv(_missions(run), out or run / "missions.csv"))
    if to is Format.plan:
        text, remarks = _plan(run, str(home))
        return _wrote(_write(out or run / "route.plan", text), remarks)
    load("tuner.campaign.campaign")
    found = _files(*_recommended(run), {to.value: onto} if onto else None)
    file = next((file for file in found if file.name == to.value), None)
    if file is None:
        raise UserError(
            f"the missions of {run} are not ours; run: gatetune export {run} --to {found[0].name}"
        )
    if not file.useful:
        why = f": {file.remarks[0]}" if not file.text else ""
        raise UserError(
            f"{file.name} carries none of the changes ({', '.join(file.lost)}){why}; "
            f"run: gatetune export {run} --to {found[0].name}"
        )
    said = [f"it carries {file.share}", *(f"does not transfer: {text}" for text in file.remarks)]
    _wrote(_write(out or run / file.name, file.text), said, carried=file.carried, lost=file.lost)


def _write(path: Path, text: str) -> Path:
    if not path.parent.is_dir():
        raise UserError(f"{path.parent} is no folder; make it first")
    write_atomic(path, text)
    return path


def _wrote(path: Path, remarks: Sequence[str] = (), **facts: Any) -> None:
    """Say what was written, and what is to be known of it."""
    for line in (f"wrote {path}", *remarks):
        output.print(line, markup=False, highlight=False, soft_wrap=True)
    answer_json({"wrote": path, "remarks": remarks, **facts})


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
    return campaign, campaign.recommended()


def _list_files(run: Path) -> None:
    """Which file carries how much, and the command that writes the first."""
    from tuner.report.vehicle_files import change_text

    campaign, best = _recommended(run)
    files = _files(campaign, best)
    first = f"gatetune export {run} --to {files[0].name}"
    changes = ", ".join(change_text(best, path) for path in best.changed)
    said = [
        f"{f.name} carries {f.share}" + ("; it is gatetune's own file" if f.name == OURS else "")
        for f in files
    ]
    for line in (f"recommended: {changes or 'keep the default'}", *said, f"write the first: {first}"):
        output.print(line, markup=False, highlight=False, soft_wrap=True)
    answer_json(
        {
            "values": best.values,
            "default_values": best.default_values,
            "files": [
                {"name": f.name, "carried": f.carried, "lost": f.lost, "remarks": f.remarks} for f in files
            ],
            "write": first,
        }
    )


def _files(
    campaign: Campaign, best: Recommendation, onto: dict[str, Path] | None = None
) -> list[VehicleFile]:
    """The recommendation as every file there is: those that carry nothing last, ours after the authors'."""
    from tuner.report.vehicle_files import vehicle_files

    theirs = vehicle_files(campaign, best, onto) if campaign.settings.mission is None else []
    useful = [file for file in theirs if file.useful]
    return [*useful, _our_file(campaign, best), *(file for file in theirs if not file.useful)]


def _our_file(campaign: Campaign, best: Recommendation) -> VehicleFile:
    from tuner.commands.config import commented_yaml
    from tuner.missions.external import ExternalConfig
    from tuner.problem.search_space import ours
    from tuner.report.vehicle_files import VehicleFile, header

    config = campaign.settings.config(best.values)
    if isinstance(config, ExternalConfig):
        lines = yaml.safe_dump(dict(config.values), sort_keys=False).splitlines()
    else:
        lines = commented_yaml(ours(config))
    comment = [f"# {line}" for line in header(campaign, best, best.changed)]
    return VehicleFile(OURS, "\n".join([*comment, *lines]) + "\n", best.changed, (), ())


def _plan(run: Path, home: str) -> tuple[str, list[str]]:
    from tuner.bridges import Home, qgc_plan
    from tuner.campaign.settings_file import SETTINGS_FILE

    try:
        numbers = [float(part) for part in home.split(",")]
        place = Home(*numbers)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"--home {home!r} is not LATITUDE,LONGITUDE[,ALTITUDE] in degrees and metres"
        ) from error
    flown = _recommended_mission(run) if (run / SETTINGS_FILE).is_file() else run
    config, views = _flown(flown)
    seeds = sum(name.startswith("seed_") for name in views)
    said = [
        f"it carries the route of {flown}: {len(views)} photographs ({seeds} seeds, then "
        f"{len(views) - seeds} that the planner chose there), none planned above {config.pool.max_altitude_m:g} m",
        "it does not carry the gate: a fixed route repeats these views and plans nothing in the air",
    ]
    return json.dumps(qgc_plan(config, views, place), indent=1) + "\n", said


def _recommended_mission(run: Path) -> Path:
    """Where the recommended mission, or the default that it is, was flown whole."""
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.showcase import showcase_jobs, was_flown

    campaign = Campaign.open(run, read_only=True)
    jobs = showcase_jobs(campaign)
    if not jobs:
        raise UserError(f"{run} has no route: it has no recommendation, or its missions are not ours")
    if not was_flown(jobs[-1]):
        raise UserError(f"{run} has not flown its recommendation whole; run: gatetune mission view {run}")
    return jobs[-1].directory


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
