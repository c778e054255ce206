"""How a section's fields are declared, with where their defaults come from, and checked.

Every leaf of the configuration is declared with one of three functions.

``text`` is the paper as printed, ``code`` the authors' public code and simulator where the text is silent,
``not_in_paper`` everything else. ``added`` marks a field that came after missions had been recorded without it, since
version 1: where it has its default, digests leave it out. ``names`` lists what a field may name
(`nbv.config.registry`). A unit is the ending of the field's name (see `split_unit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, cast

from nbv.errors import UserError

Origin = Literal["text", "code", "ours"]
T = TypeVar("T")

ADDED = {"added": True}  # also of a whole section
_UNITS = {
    "m": "m",
    "mm": "mm",
    "px": "px",
    "deg": "°",
    "s": "s",
    "kg": "kg",
    "dn": "DN",
    "ev": "EV",
    "percent": "%",
    "deg_s": "°/s",
    "m_s": "m/s",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "rad_s": "rad/s",
    "rad_s2": "rad/s²",
    "rad_s3": "rad/s³",
}


@dataclass(frozen=True)
class Parameter:
    """One leaf of the configuration: what its field declares, and its place, which `nbv.config.reference` adds."""

    meaning: str  # in a few words
    source: Origin  # of the default
    where: str = ""  # in the source, or why it is ours
    label: str = ""  # a name for reports, where the field's own does not do
    symbol: str = ""  # the paper's
    added: bool = False  # the field came after missions had been recorded without it
    least: float | None = None  # of the range of its value, both ends in it; ``most`` needs ``least``
    most: float | None = None
    names: Callable[[], Collection[str]] | None = None  # what it may name
    path: str = ""  # "gate.budget_fraction"
    default: Any = None
    choices: tuple[str, ...] = ()  # of a categorical parameter

    @property
    def section(self) -> str:
        """First part of the path; empty for the mission's own fields."""
        return self.path.rpartition(".")[0].partition(".")[0]

    @property
    def words(self) -> str:
        """The field's name without its unit."""
        return split_unit(self.path.rpartition(".")[2])[0]

    @property
    def unit(self) -> str:
        """``""`` if it has none."""
        return split_unit(self.path.rpartition(".")[2])[1]

    @property
    def origin(self) -> str:
        """``"text, Eq. 9"``."""
        return f"{self.source}, {self.where}" if self.where else self.source


def text(default: T, where: str, meaning: str, **more: Any) -> T:
    """A default that the paper's text states, ``where`` (section, equation or table); ``more`` as `Parameter` has it."""
    return _field(default, Parameter(meaning, "text", where, **more))


def code(default: T, where: str, meaning: str, **more: Any) -> T:
    """A default of the authors' public code or simulator, ``where``, about which the text is silent."""
    return _field(default, Parameter(meaning, "code", where, **more))


def not_in_paper(default: T, meaning: str, *, why: str = "", **more: Any) -> T:
    """A default of this project, and ``why``."""
    return _field(default, Parameter(meaning, "ours", why, **more))


def _field(default: T, about: Parameter) -> T:
    metadata = {"about": about, **(ADDED if about.added else {})}
    return cast(T, dataclasses.field(default=default, metadata=metadata))


def split_unit(name: str) -> tuple[str, str]:
    """A field's name in words and the unit that it ends in: ``("theta min", "°")``; no unit is ``""``."""
    words = name.split("_")
    for start in range(1, len(words)):
        if unit := _UNITS.get("_".join(words[start:])):
            return " ".join(words[:start]), unit
    return " ".join(words), ""


class Section:
    """What the sections share: checks that name the field, its value and the rule."""

    def _need(self, ok: bool, name: str, rule: str) -> None:
        if not ok:
            raise UserError(f"{name} is {getattr(self, name)!r}; it must be {rule}")

    def _need_positive(self, *names: str) -> None:
        for name in names:
            self._need(getattr(self, name) > 0, name, "positive")

    def _need_at_least(self, low: float, *names: str) -> None:
        rule = "0 or more" if low == 0 else f"at least {low:g}"
        for name in names:
            self._need(getattr(self, name) >= low, name, rule)

    def __post_init__(self) -> None:
        """Check what fields declare: a range, or that a name is one of a part of the program."""
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            about = f.metadata.get("about")
            if about is None:  # a section of its own
                continue
            value, least, most = getattr(self, f.name), about.least, about.most
            if least is not None and most is not None:
                self._need(least <= value <= most, f.name, f"between {least:g} and {most:g}")
            elif least is not None:
                self._need_at_least(least, f.name)
            if about.names is not None and value not in (allowed := about.names()):
                raise UserError(
                    f"{f.name} is {value!r}; allowed: {', '.join(allowed)}, or a plug-in once it is installed"
                )

    def _need_elevations(self, *names: str) -> None:
        for name in names:
            inside = all(-90.0 < elevation < 90.0 for elevation in getattr(self, name))
            self._need(inside, name, "elevations between -90 and 90 degrees")
