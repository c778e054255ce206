"""How a section's fields are declared, with where their defaults come from, and checked.

Every leaf of the configuration is declared with one of three functions.

``text`` is the paper as printed, ``code`` the authors' public code and simulator where the text is silent,
``ours`` everything else. ``added`` marks a field that came after missions had been recorded without it, since
version 1: where it has its default, digests leave it out. ``names`` lists what a field may name
(`nbv.config.registry`). A unit is the ending of the field's name (see `split_unit`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from typing import Any, Literal, TypeVar, cast

from nbv.errors import UserError

Source = Literal["text", "code", "ours"]
T = TypeVar("T")

# Also of a whole section.
ADDED_SINCE_VERSION_1 = {"added_since_version_1": True}
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


def text(default: T, where: str, meaning: str, **more: Any) -> T:
    """A default that the paper's text states, ``where`` (section, equation or table); ``more`` as `_described` has it."""
    return _described(default, "text", where, meaning, **more)


def code(default: T, where: str, meaning: str, **more: Any) -> T:
    """A default of the authors' public code or simulator, ``where``, about which the text is silent."""
    return _described(default, "code", where, meaning, **more)


def ours(default: T, meaning: str, *, why: str = "", **more: Any) -> T:
    """A default of this project, and ``why``."""
    return _described(default, "ours", why, meaning, **more)


def _described(
    default: T,
    source: Source,
    where: str,
    meaning: str,
    *,
    label: str = "",
    symbol: str = "",
    added: bool = False,
    least: float | None = None,
    most: float | None = None,
    names: Callable[[], Collection[str]] | None = None,
) -> T:
    """A field of a section.

    Parameters
    ----------
    default
        Its value where nothing else is said.
    source, where
        Of the default.
    meaning
        In a few words.
    label, symbol
        For reports: a name, where the field's own does not do, and the paper's symbol.
    added
        The field came after missions had been recorded without it.
    least, most
        The range of its value, both ends in it; ``most`` needs ``least``.
    names
        What it may name.
    """
    metadata: dict[str, Any] = {
        "source": source,
        "where": where,
        "meaning": meaning,
        "label": label,
        "symbol": symbol,
    }
    if added:
        metadata |= ADDED_SINCE_VERSION_1
    metadata |= {"least": least, "most": most}
    if names is not None:
        metadata["names"] = names
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
            value, least, most = getattr(self, f.name), f.metadata.get("least"), f.metadata.get("most")
            if least is not None and most is not None:
                self._need(least <= value <= most, f.name, f"between {least:g} and {most:g}")
            elif least is not None:
                self._need_at_least(least, f.name)
            if "names" in f.metadata and value not in (allowed := f.metadata["names"]()):
                raise UserError(f"{f.name} is {value!r}; allowed: {', '.join(allowed)}")

    def _need_elevations(self, *names: str) -> None:
        for name in names:
            inside = all(-90.0 < elevation < 90.0 for elevation in getattr(self, name))
            self._need(inside, name, "elevations between -90 and 90 degrees")
