"""A study's command: options that several have, and a function run by ``python -m``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from nbv.errors import UserError

QuickRocks = Annotated[
    list[str] | None,
    typer.Option("--rock", help="Training rock or mesh file, repeatable (default: slab, vesicular, cavern)."),
]
Surface = Annotated[str, typer.Option(help="observable or whole.")]
Fidelity = Annotated[
    str, typer.Option(help="photogrammetric, or geometric: seconds instead of hours, no photographs.")
]


def run(*commands: Callable[..., None]) -> None:
    """Run one command, or the one of several that the first argument names; a user's mistake is one line, exit 2."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    for command in commands:
        app.command()(command)
    try:
        app()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
