"""A study's command: a function with its options, run by ``python -m``."""

from __future__ import annotations

import sys
from collections.abc import Callable

import typer

from nbv.errors import UserError


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
