"""``gatetune export``: the recommendation as files for the vehicle, the missions as a table."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from nbv.config import MissionConfig, under
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.safe_files import write_atomic
from nbv.viewpoints import seed_viewpoints
from tuner.answer.answer import Answer, answer_of
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import showcase_jobs, was_run
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.commands.console import AsJson, answer_json, output
from tuner.comparison.plan import PLAN_FILE, EvaluationPlan, EvaluationRun
from tuner.export.route import Home, mission_config, qgc_plan, read_flight
from tuner.export.table import write_missions
from tuner.export.vehicle_files import OURS, Exported, vehicle_files
from tuner.problem.baselines import ANSWERS, base_name, baseline, is_ablation, scorer_alone
from tuner.problem.baselines import label as strategy_label
from tuner.report.words import sentences


class Format(StrEnum):
    scoring = "scoring.yaml"
    mission = "unified_mission.yaml"
    ours = "gatetune.yaml"
    plan = "plan"
    csv = "csv"


def export(
    run: Annotated[Path, typer.Argument(help="A campaign's run directory; for plan a mission's, too.")],
    to: Annotated[
        Format | None,
        typer.Option(
            help="scoring.yaml and unified_mission.yaml are the authors' files, gatetune.yaml is gatetune's, plan QGroundControl's; csv has a row per "
            "mission of a campaign or an evaluation. Without it the command lists what each file would carry."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="File to write (default: in RUN, under its usual name).")
    ] = None,
    home: Annotated[
        str | None, typer.Option(help="For plan: LATITUDE,LONGITUDE[,ALTITUDE] of take-off.")
    ] = None,
    rock: Annotated[
        str | None, typer.Option(help="For plan: the training rock that the planned views are of.")
    ] = None,
    strategy: Annotated[
        str | None,
        typer.Option(
            help="What is written: tuned-gate, tuned-planner, or another strategy, such as orbit (default: what to fly)."
        ),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write a recommendation that misses the objective's limit, too.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write what is advised as a file whose header says which changes it carries, or the missions as a table.

    Example: gatetune export runs/mine, then gatetune export runs/mine --to unified_mission.yaml
    """
    if (to is Format.plan) != (home is not None):
        raise UserError("--home LATITUDE,LONGITUDE belongs to --to plan, and plan needs it")
    output.print(f"reading {run}", soft_wrap=True)
    if to is Format.csv:
        return _wrote(write_missions(_missions(run), out or run / "missions.csv"))
    if to is Format.plan and not (run / SETTINGS_FILE).is_file():
        return _write_plan(run, run, _place(home), out)
    campaign = Campaign.open(run, read_only=True)
    campaign.recommended()  # says where there is none
    answer = answer_of(campaign)
    limit = list(answer.recommended.values())[-1].missed
    if to is not None and limit is not None and not anyway:
        sign = "<=" if limit.direction == "minimise" else ">="
        raise UserError(
            f"no configuration that was run is likely to meet {limit.metric} {sign} {limit.limit:g}; the nearest "
            f"misses it by {limit.missed_by:.3g} (mean {limit.mean:.4g}): allow more, or export it with --anyway"
        )
    exported = _exported(campaign, answer, strategy)
    if answer.fly is not None and exported.strategy == answer.fly.strategy:
        for line in sentences(answer):
            _say(line)
    if to is Format.plan:
        return _export_plan(exported, rock, _place(home), out)
    changes = ", ".join(map(exported.change, exported.values)) or "the default"
    _say(f"{strategy_label(exported.strategy)}: {changes}")
    if scorer := scorer_alone(exported.config):
        _say(f"its gate never switches: {strategy_label(scorer)} alone chooses every view")
    files = {file.name: file for file in vehicle_files(exported)}
    if to is None:
        others = [name for name in answer.configs if not is_ablation(name) and name != exported.strategy]
        _say(f"--strategy writes another one: {', '.join(others)}")
        for f in files.values():
            _say(f"{f.name} carries {f.share}" if f.text else f.remarks[0])
        most = max(files.values(), key=lambda f: (f.name != OURS and bool(f.carried), len(f.carried)))
        options = ["--to", most.name, *(() if strategy is None else ("--strategy", strategy))]
        options += ["--anyway"] if any(each.missed for each in answer.recommended.values()) else []
        first = shlex.join(["gatetune", "export", str(run), *options])
        _say(f"write the first: {first}")
        listed = [
            {"name": f.name, "carried": f.carried, "lost": f.lost, "remarks": f.remarks}
            for f in files.values()
        ]
        return answer_json({"values": exported.values, "files": listed, "write": first})
    file = files[to.value]
    if not file.text:
        raise UserError(f"{file.remarks[0]}; gatetune.yaml has all: --to gatetune.yaml")
    lines = [f"it carries {file.share}", *(f"does not transfer: {text}" for text in file.remarks)]
    _wrote(_write(out or run / file.name, file.text), lines, carried=file.carried, lost=file.lost)


def _say(line: str) -> None:
    output.print(line, highlight=False, soft_wrap=True)


def _write(path: Path, text: str) -> Path:
    if not path.parent.is_dir():
        raise UserError(f"{path.parent} is not a folder; make it first")
    write_atomic(path, text)
    return path


def _wrote(path: Path, remarks: Sequence[str] = (), **facts: Any) -> None:
    for line in (f"wrote {path}", *remarks):
        _say(line)
    answer_json({"wrote": path, "remarks": remarks, **facts})


def _missions(run: Path) -> Any:
    if not (run / PLAN_FILE).is_file():
        return Campaign.open(run, read_only=True)
    plan = EvaluationPlan.load(run)
    return EvaluationRun(plan, plan.records(run), complete=True, elapsed_s=0.0, directory=run)


def _place(home: str | None) -> Home:
    try:
        return Home(*(float(part) for part in str(home).split(",")))
    except (TypeError, ValueError) as error:
        raise UserError(
            f"--home {home!r} is not LATITUDE,LONGITUDE[,ALTITUDE] in degrees and metres"
        ) from error


def _exported(campaign: Campaign, answer: Answer, strategy: str | None) -> Exported:
    """What is to be flown, or the strategy of the answer that is named."""
    assert answer.fly is not None
    name = strategy or answer.fly.strategy
    ran = [n for n in answer.configs if name in (n, base_name(n))]
    if ran:
        # Of several numbers of photographs the first.
        return Exported(campaign, ran[0], answer.configs[ran[0]], answer.recommended.get(ran[0]))
    return Exported(campaign, name, baseline(name, ANSWERS).config(campaign.settings.problem.base))


def _export_plan(exported: Exported, rock: str | None, home: Home, out: Path | None) -> None:
    """Write the route of a plan without planned views for any target, else that of the mission that was run about ``rock``."""
    s, run = exported.campaign.settings, exported.campaign.directory
    config = exported.config
    if config.planned_views == 0:
        config = under(config, s.conditions[0])
        height_m = 2.0 * config.target_m[2]
        lines = f"the route is for a target {height_m:g} m high whose centre lies 0 m east and north of the origin"
        views = [view.id for view in seed_viewpoints(config)]
        return _write_route(config, views, home, out or run / "route.plan", [lines])
    remedy = "run a mission about your target (gatetune mission run --config gatetune.yaml --rock MESH) and export its directory"
    if exported.best is None or exported.strategy != exported.campaign.settings.problem.answers[-1].name:
        raise UserError(f"{exported.strategy} plans views, which hold for one target: {remedy}")
    jobs, shown = showcase_jobs(exported.campaign), Path(s.rocks[0]).stem
    if not jobs:
        raise UserError(f"{run} has no route: it has no recommendation, or its fidelity is a plug-in's")
    if not was_run(jobs[-1]):
        raise UserError(
            f"{run} has not run its recommendation with everything kept; run: gatetune mission view {shlex.quote(str(run))}"
        )
    if rock is None or Path(rock).stem != shown:
        raise UserError(
            f"planned views hold for the target that they were planned on: name it with --rock {shown}, or {remedy}"
        )
    _write_plan(run, jobs[-1].directory, home, out)


def _write_plan(run: Path, source: Path, home: Home, out: Path | None) -> None:
    MissionResult.load(source)  # it has finished
    flight, config = read_flight(source), mission_config(source)
    views = list(flight.photographed_m())
    seeds = sum(name.startswith("seed_") for name in views)
    route = f"it carries the route of {source}: {len(views)} photographs ({seeds} seeds, then {len(views) - seeds} planned there)"
    _write_route(config, views, home, out or run / "route.plan", [route])


def _write_route(
    config: MissionConfig, views: Sequence[str], home: Home, out: Path, lines: Sequence[str]
) -> None:
    lines = [
        *lines,
        "it does not carry the gate: a fixed route repeats these views and plans nothing in the air",
    ]
    _wrote(_write(out, json.dumps(qgc_plan(config, views, home), indent=1) + "\n"), lines)
