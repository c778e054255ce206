"""``gatetune config show|paths|spaces``."""

from __future__ import annotations

from typing import Annotated

import typer
import yaml

from tuner.commands.console import mission_config, output

app = typer.Typer(no_args_is_help=True)


@app.command()
def show(
    preset: Annotated[str, typer.Option(help="paper, paper-code or campaign.")] = "paper",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE")] = None,
) -> None:
    """The complete configuration of a preset as YAML; every key is a parameter path."""
    output.print(yaml.safe_dump(mission_config(preset, set_ or []).to_dict(), sort_keys=False), end="")
