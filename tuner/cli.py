"""The command ``gatetune``: three jobs (campaign, evaluate, reproduce) and what they are made of."""

from __future__ import annotations

import sys
from importlib import metadata
from typing import Annotated

from nbv.threads import single_thread_environment

single_thread_environment()  # before anything imports numpy: one mission, one thread

import typer  # noqa: E402

from nbv.errors import UserError  # noqa: E402
from tuner.commands import (  # noqa: E402
    cache,
    campaign,
    config,
    doctor,
    evaluate,
    export,
    learn_gate,
    mission,
    reproduce,
    rocks,
    studies,
)
from tuner.commands.console import errors, output  # noqa: E402

app = typer.Typer(
    name="gatetune",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        output.print(f"gatetune {metadata.version('gatetune')}", highlight=False)
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Print the version.")
    ] = False,
) -> None:
    """Tune hybrid next-best-view planning with Bayesian optimisation on real photogrammetry missions."""


app.add_typer(campaign.app, name="campaign", help="Job 1: run, resume and look at a GP tuning campaign.")
app.command(name="evaluate", help="Job 2: the tuned configuration against the baselines on held-out rocks.")(
    evaluate.evaluate
)
app.command(name="reproduce", help="Job 3: the paper's default configuration in the layout of its Table I.")(
    reproduce.reproduce
)
app.command(name="export", help="The recommendation as files for the vehicle.")(export.export)
app.add_typer(studies.app, name="study", help="How noisy the objective is; what it depends on.")
app.command(name="learn-gate", help="Train the learned gate from missions' logs.")(learn_gate.learn_gate)
app.add_typer(mission.app, name="mission", help="Fly one mission; explain its decisions; draw its figures.")
app.add_typer(rocks.app, name="rocks", help="List, show and import rocks.")
app.add_typer(cache.app, name="cache", help="The store of photographs, features, pairs and seed models.")
app.command(name="doctor", help="Is this machine fit for missions, and what mends it?")(doctor.doctor)
app.add_typer(config.app, name="config", help="Presets, parameter paths and search spaces.")


def main() -> None:
    """Entry point: a user's mistake is one line and exit code 2, never a traceback."""
    try:
        app()
    except UserError as error:
        errors.print(f"[bold red]error:[/] {error}", highlight=False, soft_wrap=True, markup=True)
        sys.exit(2)
    except KeyboardInterrupt:
        errors.print("interrupted")
        sys.exit(130)


if __name__ == "__main__":
    main()
