"""Settings that are declared once: a setting is one field of a dataclass, made by `setting`.

Command line, YAML form, messages and the reference page are made from what the field says.
"""

from __future__ import annotations

import dataclasses
import difflib
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from nbv.config.parsing import coerce
from nbv.errors import UserError
from nbv.safe_files import require


@dataclass(frozen=True)
class Setting:
    """What a field says of itself."""

    meaning: str  # a phrase; where there are choices, they follow it after a colon
    default: Any = None  # or a function that makes it
    shown: str = ""  # the default in words, where it is no plain value
    unit: str = ""
    why: str = ""  # the reason for the default, or where it comes from
    choices: Callable[[], Iterable[str]] | None = None  # a type Literal[...] has its own
    at_least: float | None = None
    limit: float | None = None  # GATETUNE_LIMITS raises it
    option: str = ""  # of the command line, "--rock"; none: only a settings file has it
    panel: str = ""  # of the command's help
    in_file: str = ""  # what a settings file may say besides
    has_paths: bool = False  # relative ones are taken from the settings file's folder
    builtin: bool = False  # of our own missions; a mission file says it itself, or has none
    # (YAML form, source) to value, where the type does not say how.
    read: Callable[[Any, str], Any] | None = None
    write: Callable[[Any], Any] | None = None
    name: str = ""  # the field's
    kind: Any = None  # its type

    @property
    def names(self) -> tuple[str, ...]:
        """The choices."""
        if self.choices is not None:
            return tuple(self.choices())
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is typing.Literal else ()

    @property
    def default_text(self) -> str:
        """The default for people; empty where there is none."""
        if self.shown or self.default is None or callable(self.default):
            return self.shown
        return f"{self.default} {self.unit}".strip()

    @property
    def text(self) -> str:
        """The meaning, with the choices."""
        return f"{self.meaning}: {', '.join(self.names)}" if self.names else self.meaning

    def check(self, value: Any) -> None:
        """Raise `UserError` where ``value`` is none of the choices, too small or too large."""
        if isinstance(value, str) and self.names and value not in self.names:
            raise UserError(f"{self.name} is {value!r}; it must be one of {', '.join(self.names)}")
        if self.at_least is not None and value is not None and value < self.at_least:
            raise UserError(
                f"{self.name} is {f'{value} {self.unit}'.strip()}; give at least {self.at_least:g}"
            )
        if self.limit is not None:
            require(value, self.limit, self.name)

    def from_yaml(self, raw: Any, source: str) -> Any:
        """Return the value of a YAML form; `UserError`, which names ``source``, where it is of another kind."""
        if self.read is not None:
            return self.read(raw, source)
        try:
            return coerce(self.kind, raw, f"{source}: {self.name}")
        except UserError as error:
            raise UserError(f"{error} ({self.meaning})") from None

    def to_yaml(self, value: Any) -> Any:
        """Return the inverse of `from_yaml`."""
        if self.write is not None:
            return None if value is None else self.write(value)
        if isinstance(value, Mapping):
            return dict(value)
        return list(value) if isinstance(value, tuple) else value


def setting(default: Any, meaning: str, **more: Any) -> Any:
    """Return a field: its default, or a function that makes it, its meaning, and ``more`` of what `Setting` has."""
    about = {"setting": Setting(meaning, default, **more)}
    if callable(default):
        return dataclasses.field(default_factory=default, metadata=about)
    return dataclasses.field(default=default, metadata=about)


def settings_of(declared: Any) -> dict[str, Setting]:
    """Return the settings of a dataclass by name, in the order of its fields."""
    kinds = typing.get_type_hints(declared)
    return {
        f.name: dataclasses.replace(f.metadata["setting"], name=f.name, kind=kinds[f.name])
        for f in dataclasses.fields(declared)
    }


def require_settings(declared: type, tree: Any, source: str) -> None:
    """Raise `UserError` where ``tree`` is no mapping of settings, or has one that there is not or of the wrong kind."""
    if not isinstance(tree, Mapping):
        raise UserError(f"{source}: settings map names to values, such as `budget: 64`")
    known = settings_of(declared)
    for key, raw in tree.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(known)}"
            raise UserError(f"{source}: there is no setting {key!r}; {hint}")
        if raw is not None and known[key].read is None:
            known[key].from_yaml(raw, source)


def values_of(declared: type, tree: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Return the values of a YAML form, by name; null is as if it were left out."""
    known = settings_of(declared)
    return {key: known[key].from_yaml(raw, source) for key, raw in tree.items() if raw is not None}
