"""``gatetune mission run|explain|view``."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from nbv.cache import Store
from nbv.config import IDEAL, config_from_dict
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from nbv.rocks import load_rock
from nbv.safe_files import read_yaml
from tuner.answer.answer import answer_of
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.commands.campaign import write_pages
from tuner.commands.console import (
    CONDITION_HELP,
    PRESET_NAMES,
    AsJson,
    answer_json,
    load,
    local_pool,
    mission_config,
    note_dense_stage,
    output,
    show_table,
    working,
)
from tuner.commands.options import Overrides
from tuner.export.route import planned_config
from tuner.missions.registry import DEFAULT_FIDELITY, kind_on, usual_preset
from tuner.report.labels import duration, format_number

app = typer.Typer(no_args_is_help=True)
RockFile = Annotated[str | None, typer.Option(help="Mesh file of a rock that is not in the catalogue.")]


@app.command()
def run(
    rock: Annotated[str, typer.Option(help="Catalogue name (see `gatetune rocks list`) or path of a mesh.")],
    preset: Annotated[
        str | None,
        typer.Option(help=f"{PRESET_NAMES} (default: photographs for a set of photographs, else campaign)"),
    ] = None,
    config_file: Annotated[
        Path | None,
        typer.Option("--config", help="A whole configuration, such as gatetune.yaml of gatetune export."),
    ] = None,
    gate: Annotated[str | None, typer.Option(help="covis, b-aware, hyb-h, hyb-o, random, ...")] = None,
    condition: Annotated[
        str | None, typer.Option(help=f"{CONDITION_HELP} (default: ideal, or that of --config)")
    ] = None,
    set_: Overrides = None,
    replicate: Annotated[
        int, typer.Option(min=0, help="Number of the replicate, which draws arrival errors and sensor noise.")
    ] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Run directory (default: in runs/, named after rock and gate).")
    ] = None,
    overwrite: Annotated[bool, typer.Option(help="Replace a finished mission in that directory.")] = False,
) -> None:
    """Run one complete mission and print its metrics.

    Example: gatetune mission run --rock slab --gate hyb-h
    """
    base = None if config_file is None else config_from_dict(read_yaml(config_file))
    config = mission_config(preset or usual_preset([rock]), set_ or [], gate, condition, base)
    instance = Path(rock).stem if config.condition == IDEAL else f"{Path(rock).stem}-{config.condition}"
    directory = out or Path("runs") / f"mission-{instance}-{config.gate.kind}-{replicate}"
    output.print(f"mission on {rock} in {directory}", soft_wrap=True)  # before what takes seconds to load
    kind = kind_on(rock, DEFAULT_FIDELITY)
    kind.require_dense_stage(config)
    note_dense_stage(kind, config)
    load(str(kind.runs).partition(":")[0])
    with working(f"making rock {rock}"):
        load_rock(rock, Store())  # a mistake shows before the progress bar
    with working("running"):
        log = functools.partial(output.print, highlight=False, soft_wrap=True)
        result = kind(config, rock, replicate, directory, overwrite=overwrite, log=log)
    colour = {"ok": "green", "degraded": "yellow", "failed": "red"}[result.status]
    output.print(f"[{colour}]{result.status}[/]  {escape(result.message)}", markup=True)
    if result.status != "failed":
        show_metrics(result.metrics)
    output.print(
        f"{result.costs['images']:.0f} images ({result.costs['registered_images']:.0f} registered), "
        f"{result.costs['path_length_m']:.0f} m flown in {duration(result.costs['flight_time_s'])} (simulated), "
        f"computed in {duration(result.costs['wall_s'])}; everything is in {directory}"
    )
    if result.status == "failed":
        raise typer.Exit(1)


def show_metrics(metrics: dict[str, Any]) -> None:
    """Print the metrics on both surfaces; for a photograph set beside those of one half against the other."""
    columns = {f"{name} surface": metrics[name] for name in ("whole", "observable") if name in metrics}
    title = "Dense cloud against ground truth"
    if "reference" in metrics:
        title = "Dense cloud against the dense reference; 48 mm are 3 % of the height"
        half = metrics["reference"]["ceiling"]
        columns = {"mission": metrics["observable"], "half against half": half}
    rows = []
    for key, first in next(iter(columns.values())).items():
        if isinstance(first, (int, float)):
            rows.append((key, *(format_number(column.get(key)) for column in columns.values())))
    show_table(("metric", *columns), rows, title)


@app.command()
def explain(
    mission: Annotated[Path, typer.Argument(help="A mission's directory.")], as_json: AsJson = False
) -> None:
    """Print what the gate decided at each step and why, with the values that it compared with its thresholds.

    Example: gatetune mission explain runs/mine/shown/tuned-planner
    """
    if (mission / SETTINGS_FILE).is_file():
        raise UserError(
            f"{mission} is a campaign; name one of its missions, such as {mission}/shown/tuned-planner"
        )
    gate, trace = planned_config(mission).gate, MissionResult.load(mission).trace
    if gate.kind == "hyb-h":
        output.print(
            f"gate.budget_fraction {gate.budget_fraction:g}, gate.d95_m {gate.d95_m:g} m", highlight=False
        )
    for entry in trace:
        best = ", ".join(
            f"{name} {scored['candidate']} {scored['score']:.3f}" for name, scored in entry.top.items()
        )
        text = f"step {entry.iteration + 1}: {entry.scorer} chose {entry.chosen}, since {entry.reason}"
        output.print(f"{text} (best scores: {best})", highlight=False, soft_wrap=True)
    if not trace:
        output.print(f"gate {gate.kind}: no step was planned", highlight=False)
    answer_json({"mission": mission, "gate": gate, "steps": trace})


@app.command()
def view(
    run: Annotated[
        Path,
        typer.Argument(help="Directory of a mission that kept all its files, or of a campaign."),
    ],
    other: Annotated[
        Path | None, typer.Argument(help="A second mission, shown beside it with the same camera.")
    ] = None,
    rock: RockFile = None,
    out: Annotated[Path | None, typer.Option(help="The page (default: RUN/view.html).")] = None,
) -> None:
    """Write an interactive 3D page that opens without a server: rock, clouds, cameras, pool and path, capture by capture.

    Example: gatetune mission view runs/mission-slab-hyb-h-0
    """
    from tuner.report.mission_view import write_mission_view

    if (run / SETTINGS_FILE).is_file():
        campaign = Campaign.open(run, read_only=True)
        output.print(f"campaign in {run}: running the missions that its page still needs", soft_wrap=True)
        with local_pool(campaign.settings.fidelity, None, 3600.0) as executor:
            return write_pages(campaign, answer_of(campaign), executor)
    runs = [run] if other is None else [run, other]
    page = out or run / ("view.html" if other is None else f"view-beside-{other.resolve().name}.html")
    with working("writing the page"):
        write_mission_view(runs, page, rock)
    output.print(f"wrote {page}", highlight=False, soft_wrap=True)
