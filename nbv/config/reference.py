"""The parameters for people: what each is, its unit, and where its default comes from."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Iterator
from typing import Any, Literal

from nbv.config.mission_config import MissionConfig
from nbv.config.sources import Parameter


@functools.cache
def parameters() -> dict[str, Parameter]:
    """Every parameter by its path, in declaration order."""
    return {found.path: found for found in _leaves(MissionConfig(), "")}


def parameter(path: str) -> Parameter:
    """The parameter at ``path``; ``KeyError`` if there is none."""
    return parameters()[path]


def _leaves(section: Any, prefix: str) -> Iterator[Parameter]:
    hints = typing.get_type_hints(type(section))
    for f in dataclasses.fields(section):
        value, path, kind = getattr(section, f.name), f"{prefix}{f.name}", hints[f.name]
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{path}.")
            continue
        about: Parameter = f.metadata["about"]
        choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
        choices = tuple(about.names()) if about.names is not None else choices
        yield dataclasses.replace(about, path=path, default=value, choices=choices)
