"""``gatetune export``: the recommendation as files for the vehicle, the missions as a table."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from nbv.config import MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.foreign import RESULT_BYTES, RESULT_NODES, read_json, read_yaml
from nbv.mission.run_directory import write_atomic
from tuner.commands.console import load, output, working

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
    run: Annotated[Path, typer.Argument(help="A campaign's run directory; for plan a mission's.")],
    to: Annotated[
        Format,
        typer.Option(
            help="scoring.yaml and unified_mission.yaml are the authors' files; plan is QGroundControl's; csv, json and parquet "
            "hold a row per mission of a campaign or an evaluation; optuna is a folder for optuna-dashboard."
        ),
    ],
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
    """Write the recommendation as a file with a header that says where it is from and what does not transfer, or a table.

    Example: gatetune export runs/mine --to scoring.yaml
    """
    if (to is Format.plan) != (home is not None):
        raise UserError("--home LATITUDE,LONGITUDE belongs to --to plan, and plan needs it")
    output.print(f"exporting {to.value} of {run}", soft_wrap=True)  # before what takes seconds to load
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
    output.print(f"wrote {path}", markup=False)
    for remark in remarks:
        output.print(f"does not transfer: {remark}", markup=False, highlight=False)


def _missions(run: Path) -> Any:
    """The campaign, or the evaluation, in ``run``."""
    from tuner.campaign.campaign import Campaign
    from tuner.evaluation.flying import EvaluationRun
    from tuner.evaluation.plan import PLAN_FILE, EvaluationPlan

    if not (run / PLAN_FILE).is_file():
        return Campaign.open(run, read_only=True)
    plan = EvaluationPlan.load(run)
    return EvaluationRun(plan, plan.records(run), complete=True, elapsed_s=0.0)


def _yaml(run: Path, to: Format, onto: Path | None) -> tuple[str, list[str]]:
    from tuner.campaign.campaign import Campaign
    from tuner.problem.search_space import ours
    from tuner.report.campaign.vehicle_files import authors_file, header

    campaign = Campaign.open(run, read_only=True)
    config, best = campaign.recommended_config(), campaign.recommendation(save=False)
    if to is not Format.ours:
        return authors_file(campaign, config, to.value, best, onto)
    from tuner.commands.config import commented_yaml
    from tuner.missions.external import ExternalConfig

    if isinstance(config, ExternalConfig):
        lines = yaml.safe_dump(dict(config.values), sort_keys=False).splitlines()
    else:
        lines = commented_yaml(ours(config))
    return "\n".join([*(f"# {line}" for line in header(campaign, best)), *lines]) + "\n", []


def _plan(run: Path, home: str) -> tuple[str, list[str]]:
    from adapters.mavlink import Home, qgc_plan

    try:
        numbers = [float(part) for part in home.split(",")]
        place = Home(*numbers)
    except (TypeError, ValueError) as error:
        raise UserError(
            f"--home {home!r} is not LATITUDE,LONGITUDE[,ALTITUDE] in degrees and metres"
        ) from error
    config, views = _flown(run)
    note = "a fixed route: it repeats this mission's views and plans nothing in the air"
    return json.dumps(qgc_plan(config, views, place), indent=1) + "\n", [note]


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
