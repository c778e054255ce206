"""How the fields of a mission's configuration and of a campaign's settings are declared, read and checked.

A field is one line of a dataclass. What it declares (`Declaration`) makes its option, its YAML form, its messages and its row
in the reference pages. Fields are made by `text` (the paper states the default), `code` (the authors' public code does),
`not_in_paper` (the default is gatetune's own) and `setting` (of a campaign).
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated, Any, Literal, TypeVar, cast

import msgspec
import numpy as np
from msgspec import Meta

from nbv.errors import UserError
from nbv.safe_files import require

Origin = Literal["text", "code", "gatetune"]
T = TypeVar("T")

# Types with bounds.
Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Elevation = Annotated[float, Meta(gt=-90, lt=90)]  # degrees
Elevations = tuple[Elevation, ...]
Count = Annotated[int, Meta(ge=0)]
OneOrMore = Annotated[int, Meta(ge=1)]
TwoOrMore = Annotated[int, Meta(ge=2)]
ThreeOrMore = Annotated[int, Meta(ge=3)]

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


_KINDS = {
    "`array`": "a list",
    "`bool`": "true or false",
    "`float": "a number`",
    "`int": "a whole number`",
    "`object`": "a mapping",
    "`str`": "a text",
    " | null": "",
    "`": "",
    ">= ": "of at least ",
    "<= ": "of at most ",
    "> ": "above ",
    "< ": "below ",
}


@dataclass(frozen=True)
class Declaration:
    """What a field declares; `declared` adds its path, type and default. Bounds are in its type."""

    meaning: str  # a phrase; where there are choices, they follow it after a colon
    source: Origin = "gatetune"  # of the default
    reason: str = ""  # the place in the source, or the reason for the default
    unit: str = ""  # by default what the field's name ends in
    limit: float | None = None  # for safety: GATETUNE_LIMITS raises it
    names: Callable[[], Collection[str]] | None = None  # the choices; a type Literal[...] has its own
    plugins: bool = False  # which plug-ins may add to
    label: str = ""  # a name for reports, where the field's own will not do
    # Of a campaign's settings:
    shown: str = ""  # the default in words
    option: str = ""  # of the command line, "--rock"; without one only a settings file sets it
    panel: str = ""  # of the command's help
    in_file: str = ""  # further forms in a settings file
    has_paths: bool = False  # relative ones start at the settings file's folder
    read: Callable[[Any, str], Any] | None = (
        None  # (YAML form, source) to value, where the type does not tell
    )
    write: Callable[[Any], Any] | None = None
    # Of the field:
    path: str = ""  # "gate.budget_fraction"
    kind: Any = None
    default: Any = None

    @property
    def section(self) -> str:
        """First part of the path; empty for the mission's own fields."""
        return self.path.rpartition(".")[0].partition(".")[0]

    @property
    def words(self) -> str:
        """The field's name without its unit."""
        return split_unit(self.path.rpartition(".")[2])[0]

    @property
    def origin(self) -> str:
        """``"text, Eq. 9"``."""
        return f"{self.source}, {self.reason}" if self.reason else self.source

    @property
    def choices(self) -> tuple[str, ...]:
        """What a categorical field may be."""
        if self.names is not None:
            return tuple(self.names())
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is Literal else ()

    @property
    def default_text(self) -> str:
        """The default for people; empty where there is none."""
        if self.shown or self.default is None or callable(self.default):
            return self.shown
        return f"{self.default} {self.unit}".strip()

    @property
    def text(self) -> str:
        """The meaning, with the choices."""
        return f"{self.meaning}: {', '.join(self.choices)}" if self.choices else self.meaning

    def check(self, value: Any) -> None:
        """Raise `UserError`, which begins with the path, where ``value`` is of another kind, beyond a bound, or none of the choices."""
        if self.read is None:
            value_of(self.kind, value, self.path)
        if self.names is not None and isinstance(value, str) and value not in self.names():
            more = ", or a plug-in that is installed or named with gatetune --plugin" if self.plugins else ""
            raise UserError(f"{self.path} is {value!r}; allowed: {', '.join(self.names())}{more}")
        if self.limit is not None:
            require(value, self.limit, self.path)

    def from_yaml(self, raw: Any, source: str = "") -> Any:
        """Return the value of a YAML form; `UserError`, which names ``source`` and path, where it is of another kind."""
        if self.read is not None:
            return self.read(raw, source)
        return value_of(self.kind, raw, f"{source}: {self.path}" if source else self.path)

    def to_yaml(self, value: Any) -> Any:
        """Return the inverse of `from_yaml`."""
        if self.write is not None:
            return None if value is None else self.write(value)
        if isinstance(value, Mapping):
            return dict(value)
        return list(value) if isinstance(value, tuple) else value


def text(default: T, reason: str, meaning: str, **more: Any) -> T:
    """A default that the paper's text states, at ``reason`` (section, equation or table); ``more`` as `Declaration` has it."""
    return cast(T, setting(default, meaning, source="text", reason=reason, **more))


def code(default: T, reason: str, meaning: str, **more: Any) -> T:
    """A default of the authors' public code or simulator, at ``reason``, about which the text is silent."""
    return cast(T, setting(default, meaning, source="code", reason=reason, **more))


def not_in_paper(default: T, meaning: str, **more: Any) -> T:
    """A default of gatetune's own; ``reason`` says why, as `Declaration` has it."""
    return cast(T, setting(default, meaning, **more))


def setting(default: Any, meaning: str, **more: Any) -> Any:
    """A field with its default, or a function that makes it; ``more`` as `Declaration` has it."""
    metadata = {"declaration": Declaration(meaning, default=default, **more)}
    if callable(default):
        return dataclasses.field(default_factory=default, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def unbounded(kind: Any) -> Any:
    """A type without its bounds, and without None where it may be left out."""
    if typing.get_origin(kind) is Annotated:
        return kind.__origin__
    optional = typing.get_origin(kind) in (types.UnionType, typing.Union)
    return unbounded(typing.get_args(kind)[0]) if optional else kind


def split_unit(name: str) -> tuple[str, str]:
    """A field's name in words and the unit that it ends in: ``("theta min", "°")``; no unit is ``""``."""
    words = name.split("_")
    for start in range(1, len(words)):
        if unit := _UNITS.get("_".join(words[start:])):
            return " ".join(words[:start]), unit
    return " ".join(words), ""


@functools.cache
def declared(cls: type) -> dict[str, Declaration]:
    """The fields of a dataclass by path, those of its sections included, in the order of declaration."""
    kinds, fields = typing.get_type_hints(cls, include_extras=True), dict[str, Declaration]()
    for f in dataclasses.fields(cls):
        kind = kinds[f.name]
        if "declaration" in f.metadata:
            declaration: Declaration = f.metadata["declaration"]
            unit = declaration.unit or split_unit(f.name)[1]
            fields[f.name] = dataclasses.replace(declaration, path=f.name, kind=kind, unit=unit)
        elif dataclasses.is_dataclass(kind):  # a section
            for name, inner in declared(cast(type, kind)).items():
                path, default = f"{f.name}.{name}", attrgetter(name)(cast(Any, f.default_factory)())
                fields[path] = dataclasses.replace(inner, path=path, default=default)
    return fields


def nearest(word: str, known: Iterable[str], count: int = 1) -> str:
    """``did you mean 'budget'?``, or what there is, for a message about an unknown word; of paths what its section has, or the sections."""
    known = list(known)
    near = difflib.get_close_matches(word, known, count)
    section = word.partition(".")[0]
    here = [each for each in known if each.startswith(f"{section}.")]
    there = here or list(dict.fromkeys(re.sub(r"\..*", ".*", each) for each in known))
    some = f"{', '.join(there[:30])}{', ...' if len(there) > 30 else ''}"
    return f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {some}"


def leaves(known: Mapping[str, Declaration], tree: Any, what: str, prefix: str = "") -> dict[str, Any]:
    """The raw values of a YAML tree, in which anything may be left out, by path; keys may be paths themselves.

    `UserError` for an unknown key, which is called ``what``, for another value where there must be a mapping, and for two values
    of one parameter.
    """
    if not isinstance(tree, Mapping):
        raise UserError(f"{prefix.rstrip('.') or what} is {repr(tree)[:60]}; it must map names to values")
    values = dict[str, Any]()
    for key, raw in tree.items():
        path, below = f"{prefix}{key}", dict[str, Any]()
        if path in known:
            below = {path: raw}
        elif any(other.startswith(f"{path}.") for other in known):
            below = leaves(known, raw, what, f"{path}.")
        else:
            raise UserError(f"unknown {what} {path!r}; {nearest(path, known, 3)}")
        for twice in below.keys() & values.keys():
            raise UserError(f"{what} {twice!r} has two values; leave one out (keys may be paths)")
        values |= below
    return values


def replaced(part: T, values: Mapping[str, Any], prefix: str = "") -> T:
    """A copy of ``part``, a dataclass, with values by path; `UserError`, which begins with the path, where one is refused."""
    new, below = dict[str, Any](), dict[str, dict[str, Any]]()
    for path, value in values.items():
        name, _, rest = path.partition(".")
        if rest:
            below.setdefault(name, {})[rest] = value
        else:
            new[name] = value
    for name, inner in below.items():
        new[name] = replaced(getattr(part, name), inner, f"{prefix}{name}.")
    try:
        return cast(T, dataclasses.replace(part, **new))  # type: ignore[type-var]
    except UserError as error:  # a section names its field, and not itself
        raise UserError(f"{prefix}{error}") from None


def value_of(kind: Any, raw: Any, path: str) -> Any:
    """``raw`` of a YAML tree as a value of type ``kind``, by `msgspec.convert`; a whole number may be written as 4.0.

    Numbers of NumPy are taken as Python's.

    `UserError`, which begins with ``path``, where it is none, beyond a bound, or not finite.
    """
    items = raw if isinstance(raw, (list, tuple)) else [raw]
    items = [x.item() if isinstance(x, np.generic) else x for x in items]
    plain = [int(x) if isinstance(x, float) and x.is_integer() else x for x in items]
    try:
        if not all(math.isfinite(x) for x in plain if isinstance(x, float)):
            raise msgspec.ValidationError("Expected a finite number")
        return msgspec.convert(plain if isinstance(raw, (list, tuple)) else plain[0], kind)
    except msgspec.ValidationError as error:
        rule, _, entry = str(error).partition(" - at ")
        rule = rule.partition(", got")[0].replace("Expected", "each must be" if entry else "it must be")
        for word, ours in _KINDS.items():
            rule = rule.replace(word, ours)
        if typing.get_origin(kind) is Literal:
            rule = f"allowed: {', '.join(typing.get_args(kind))}"
        raise UserError(f"{path} is {repr(raw)[:60]}; {rule}") from error


class Section:
    """A dataclass whose fields are checked against their declarations; messages name the field, its value and the rule."""

    def __post_init__(self) -> None:
        """Check what the fields declare."""
        cls: type = type(self)
        for path, declaration in declared(cls).items():
            if "." not in path:  # a section inside checks itself
                declaration.check(getattr(self, path))

    def _need(self, ok: bool, name: str, rule: str) -> None:
        if not ok:
            raise UserError(f"{name} is {getattr(self, name)!r}; it must be {rule}")
