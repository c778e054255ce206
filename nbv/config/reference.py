"""The parameters for people: what each is, its unit, and where its default comes from."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Iterator
from typing import Any, Literal

from nbv.config.mission_config import MissionConfig
from nbv.config.parsing import PLUGINS
from nbv.config.sources import Parameter
from nbv.plugins import settings_class


@functools.cache
def parameters() -> dict[str, Parameter]:
    """Every parameter by its path, in declaration order."""
    return {found.path: found for found in _leaves(MissionConfig(), "")}


def parameter(path: str) -> Parameter:
    """The parameter at ``path``, ours or a plug-in's; ``KeyError`` if there is none."""
    if path in parameters():
        return parameters()[path]
    section = path.partition(".")[0]
    declared = settings_class(section)
    return {p.path: p for p in _leaves(declared(), f"{section}.")}[path] if declared else parameters()[path]


def _leaves(section: Any, prefix: str) -> Iterator[Parameter]:
    hints = typing.get_type_hints(type(section))
    for f in dataclasses.fields(section):
        if f.name == PLUGINS:
            continue
        value, path, kind = getattr(section, f.name), f"{prefix}{f.name}", hints[f.name]
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{path}.")
            continue
        about: Parameter = f.metadata["about"]
        choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
        choices = tuple(about.names()) if about.names is not None else choices
        yield dataclasses.replace(about, path=path, default=value, choices=choices)
