"""Command-line options that several commands share, and options made from settings."""

from __future__ import annotations

import functools
import inspect
import typing
from collections.abc import Callable
from typing import Annotated, Any

import typer

from nbv.config.declaration import Declaration, declared, unbounded

EXECUTION = "Execution"  # panel of the help

Rocks = Annotated[
    list[str] | None,
    typer.Option(
        "--rock",
        help="Rock or mesh file, repeatable (default: held-out targets of the kinds that were tuned on).",
    ),
]
TunedRocks = Annotated[
    list[str] | None,
    typer.Option("--rock", help="Rock that the campaign was tuned on, repeatable (default: all of them)."),
]
Conditions = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        help="Condition, a name or a YAML file, repeatable (default: the campaign's; of reproduce: ideal).",
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", help="PATH=VALUE for every mission, e.g. photographs=40; repeatable."),
]
FidelityOption = Annotated[
    str,
    typer.Option(
        help="photogrammetric; or geometric: without photographs, to rank configurations, not to measure."
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(help="Missions that run in parallel (default: one per core).", rich_help_panel=EXECUTION),
]
Timeout = Annotated[
    float, typer.Option(help="A mission that takes longer is ended.", rich_help_panel=EXECUTION)
]
ExecutorOption = Annotated[
    str,
    typer.Option(
        help="Where missions run: local (processes of this machine), or dask.",
        rich_help_panel=EXECUTION,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="For --executor dask: the scheduler's address, tcp://HOST:8786 or tls://HOST:8786, or the file that it writes.",
        rich_help_panel=EXECUTION,
    ),
]


def with_settings(settings: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command an option for every setting of a dataclass that has one.

    The command's parameter ``given`` receives what the user gave: values by the setting's name. Typer makes options of a
    function's signature, and the click parameters that it makes are private to each of its versions.
    """
    options = [s for s in declared(settings).values() if s.option]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_options(**arguments: Any) -> None:
            given = {s.path: arguments.pop(s.path) for s in options}
            command(given={name: value for name, value in given.items() if value is not None}, **arguments)

        first, *others = inspect.signature(command, eval_str=True).parameters.values()
        assert first.name == "given"
        parameters = [*map(_parameter, options), *others]  # typer makes its options from them
        with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {p.name: p.annotation for p in parameters}
        return with_options

    return decorate


def _parameter(setting: Declaration) -> inspect.Parameter:
    """Return the parameter of which typer makes a setting's option; None where the user does not give it."""
    kind = unbounded(setting.kind)
    several = typing.get_origin(kind) in (tuple, dict)
    # ``Training rocks, names or mesh files; repeatable (default: the procedural ones).``
    default = f" (default: {setting.default_text})" if setting.default_text else ""
    text = f"{setting.text[0].upper()}{setting.text[1:]}{'; repeatable' if several else ''}{default}."
    option = typer.Option(
        setting.option,
        help=text,
        rich_help_panel=setting.panel,
        metavar="PATH=VALUE" if typing.get_origin(kind) is dict else None,
    )
    value: Any = list[str] if several else kind if kind in (int, float) else str
    annotation = Annotated[value | None, option]
    return inspect.Parameter(
        setting.path, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=annotation
    )
