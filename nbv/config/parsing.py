"""Configurations from nested dictionaries and parameter paths, with errors that name the path.

A parameter path such as ``gate.budget_fraction`` or ``covis.weights.nov`` names one field;
search spaces and command-line overrides use these paths. Nothing here knows which sections there are.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from typing import Any, Literal

from nbv.errors import UserError

_IN_WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    dict: "a mapping",
}
PLUGINS = "plugins"  # the field of the sections that are not ours: `nbv.config.mission_config` reads them
_type_hints = functools.cache(typing.get_type_hints)  # takes longer than everything else of a copy


def leaf_paths(cls: type, prefix: str = "") -> list[str]:
    """All leaf parameter paths of the configuration class ``cls`` in declaration order."""
    hints = _type_hints(cls)
    paths: list[str] = []
    for f in dataclasses.fields(cls):
        kind = hints[f.name]
        if f.name == PLUGINS:
            continue
        if dataclasses.is_dataclass(kind):
            paths += leaf_paths(typing.cast(type, kind), f"{prefix}{f.name}.")
        else:
            paths.append(f"{prefix}{f.name}")
    return paths


def build(cls: type, tree: dict[str, Any], prefix: str = "") -> Any:
    """An instance of ``cls`` from its complete nested dictionary.

    Raises
    ------
    UserError
        A value of the wrong type or out of range; the message begins with the parameter path.
    """
    hints = _type_hints(cls)
    values = {}
    for f in dataclasses.fields(cls):
        if f.name == PLUGINS:
            continue
        kind, raw, path = hints[f.name], tree[f.name], f"{prefix}{f.name}"
        if dataclasses.is_dataclass(kind):
            values[f.name] = build(typing.cast(type, kind), raw, f"{path}.")
        else:
            values[f.name] = coerce(kind, raw, path)
    try:
        return cls(**values)
    except UserError as error:  # a section names its field, and not itself
        raise UserError(f"{prefix}{error}") from None


def coerce(kind: Any, raw: Any, path: str) -> Any:
    """``raw`` of a YAML tree as a value of type ``kind``; `UserError`, which begins with ``path``, where it is none."""
    origin = typing.get_origin(kind)
    if origin is Literal:
        allowed = typing.get_args(kind)
        if raw not in allowed:
            raise UserError(f"{path} is {raw!r}; allowed: {', '.join(map(str, allowed))}")
        return raw
    if origin is tuple:
        args = typing.get_args(kind)
        if not isinstance(raw, (list, tuple)):
            raise UserError(f"{path} is {raw!r}; it must be a list")
        if len(args) == 2 and args[1] is Ellipsis:
            return tuple(coerce(args[0], item, path) for item in raw)
        if len(raw) != len(args):
            raise UserError(f"{path} needs {len(args)} values, not {len(raw)}")
        return tuple(coerce(a, item, path) for a, item in zip(args, raw))
    if origin is types.UnionType:  # of a type and None
        return None if raw is None else coerce(typing.get_args(kind)[0], raw, path)
    if isinstance(raw, (int, float)) and not isinstance(raw, bool):
        if not math.isfinite(raw):
            raise UserError(f"{path} is {raw!r}; it must be finite")
        if kind is float:
            return float(raw)
        if kind is int and float(raw).is_integer():
            return int(raw)
    if kind in (bool, str) and isinstance(raw, kind):
        return raw
    if origin is dict and isinstance(raw, dict):
        return dict(raw)
    raise UserError(f"{path} is {raw!r}; it must be {_IN_WORDS[origin or kind]}")
