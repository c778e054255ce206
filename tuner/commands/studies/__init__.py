"""``gatetune study``: noise and sensitivity."""

import typer

from tuner.commands.studies.noise import noise
from tuner.commands.studies.sensitivity import sensitivity

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True)
for command in (noise, sensitivity):
    app.command()(command)
