"""``gatetune config show``."""

from __future__ import annotations

from operator import attrgetter
from typing import Annotated

import typer

from nbv.config import PRESETS, parameters
from tuner.commands.console import PRESET_NAMES, AsJson, answer_json, mission_config, output
from tuner.export.vehicle_files import commented_yaml, source_of

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
