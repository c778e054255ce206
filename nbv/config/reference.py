"""The parameters for people: what each is, its unit, and where its default comes from."""

from __future__ import annotations

import dataclasses
import functools
import typing
from dataclasses import dataclass
from typing import Any, Literal

from nbv.config.mission_config import MissionConfig
from nbv.config.sources import Source, split_unit


@dataclass(frozen=True)
class Parameter:
    """One leaf of the configuration."""

    path: str  # "gate.budget_fraction"
    default: Any
    choices: tuple[str, ...]  # of a categorical parameter
    words: str  # the field's name without its unit
    unit: str  # "" if it has none
    meaning: str
    source: Source
    where: str  # in the source, or why it is ours
    label: str  # for reports; "" where ``words`` do
    symbol: str  # the paper's; "" if it has none

    @property
    def section(self) -> str:
        """First part of the path; empty for the mission's own fields."""
        return self.path.rpartition(".")[0].partition(".")[0]

    @property
    def origin(self) -> str:
        """``"text, Eq. 9"``."""
        return f"{self.source}, {self.where}" if self.where else self.source


@functools.cache
def parameters() -> dict[str, Parameter]:
    """Every parameter by its path, in declaration order."""
    return {found.path: found for found in _leaves(MissionConfig(), "")}


def parameter(path: str) -> Parameter:
    """The parameter at ``path``; ``KeyError`` if there is none."""
    return parameters()[path]


def _leaves(section: Any, prefix: str) -> list[Parameter]:
    found: list[Parameter] = []
    hints = typing.get_type_hints(type(section))
    for f in dataclasses.fields(section):
        value = getattr(section, f.name)
        if dataclasses.is_dataclass(value):
            found += _leaves(value, f"{prefix}{f.name}.")
            continue
        about, kind = f.metadata, hints[f.name]
        choices = typing.get_args(kind) if typing.get_origin(kind) is Literal else ()
        choices = tuple(about["names"]()) if "names" in about else choices
        found.append(
            Parameter(
                f"{prefix}{f.name}",
                value,
                choices,
                *split_unit(f.name),
                about["meaning"],
                about["source"],
                about["where"],
                about["label"],
                about["symbol"],
            )
        )
    return found
