"""``gatetune config show``."""

from __future__ import annotations

from operator import attrgetter
from typing import Annotated

import typer

from nbv.config import PRESETS, MissionConfig, parameters
from nbv.evaluation.registry import all_metrics
from tuner.commands.console import PRESET_NAMES, AsJson, answer_json, mission_config, output, show_table
from tuner.export.vehicle_files import commented_yaml, source_of
from tuner.problem.objective import COSTS, SHORT

app = typer.Typer(no_args_is_help=True)


@app.command()
def show(
    preset: Annotated[str, typer.Option(help=PRESET_NAMES)] = "paper",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE")] = None,
    as_json: AsJson = False,
) -> None:
    """Print the complete configuration of a preset as YAML, with every value's unit, meaning and source as a comment.

    Sources: text (the paper), code (the authors' public code), gatetune.

    Example: gatetune config show --preset campaign
    """
    config = mission_config(preset, set_ or [])
    for line in (f"# {PRESETS[preset].purpose}", *commented_yaml(config)):
        output.print(line, highlight=False, soft_wrap=True)
    rows = [
        {
            "path": about.path,
            "value": attrgetter(about.path)(config),
            "unit": about.unit,
            "meaning": about.meaning,
            "choices": about.choices,
            "source": source_of(about, attrgetter(about.path)(config), preset),
        }
        for about in parameters().values()
    ]
    answer_json({"preset": preset, "purpose": PRESETS[preset].purpose, "parameters": rows})


def metrics(as_json: AsJson = False) -> None:
    """List every metric that `--objective` takes, after the surface that it is measured on: `observable.` or `whole.`

    Example: gatetune metrics, then gatetune campaign run --objective observable.completeness_48mm
    """
    entries = [
        {
            "name": metric.key.replace("{t}", "T"),
            "what": metric.label.replace("{t}", "T"),
            "unit": metric.unit,
            "better": "larger" if metric.larger_is_better else "smaller",
        }
        for metric in all_metrics().values()
    ]
    thresholds_mm = MissionConfig().evaluation.thresholds_mm
    costs = {name: path for name, path in SHORT.items() if path in COSTS}
    columns = ("name", "what it is", "unit", "better")
    rows = [tuple(row.values()) for row in entries]
    show_table(columns, rows, "--objective SURFACE.NAME, SURFACE observable or whole")
    output.print(
        f"T: a threshold in mm, one of {', '.join(f'{t:g}' for t in thresholds_mm)} (evaluation.thresholds_mm)"
    )
    output.print(
        f"costs, as in --objective 'f_score@photographs<=21': {', '.join(costs)}; or {', '.join(COSTS)}"
    )
    answer_json({"metrics": entries, "thresholds_mm": thresholds_mm, "costs": COSTS, "short_names": costs})
