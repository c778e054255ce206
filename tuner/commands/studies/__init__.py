"""``gatetune study``: noise, departures, oracles, sensitivity, transfer."""

import typer

from tuner.commands.studies.departures import departures
from tuner.commands.studies.noise import noise
from tuner.commands.studies.oracles import oracle_states, oracles
from tuner.commands.studies.sensitivity import sensitivity
from tuner.commands.studies.transfer import transfer

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True)
for command in (noise, departures, oracles, oracle_states, sensitivity, transfer):
    app.command()(command)
