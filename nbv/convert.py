"""A tree of a file as a typed record, and what is wrong with it in words with the name of the place."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from nbv.errors import UserError

T = TypeVar("T")
_KINDS = {
    "str": "text",
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "array": "a list",
    "object": "a mapping",
    "null": "left out",
}


def converted(
    tree: Any,
    kind: type[T],
    source: str,
    dec_hook: Callable[[type, Any], Any] | None = None,
) -> T:
    """``tree`` as a ``kind``; `UserError`, which begins with ``source``, where it is none."""
    try:
        return msgspec.convert(tree, kind, dec_hook=dec_hook)
    except msgspec.ValidationError as error:
        raise UserError(f"{source}: {_words(str(error), tree, kind)}") from error


def _words(message: str, tree: Any, kind: type) -> str:
    problem, _, place = message.partition(" - at ")
    of_key, place = place.startswith("`key`"), place.rpartition("`$")[2].strip("`.")
    name, inside = re.sub(r"\[\.\.\.\]", " (an entry)", place) or "the file", f"{place}: " if place else ""
    if missing := re.search(r"missing required field `(.*)`", problem):
        return f"{inside}{missing[1]!r} is missing"
    if unknown := re.search(r"unknown field `(.*)`", problem):
        known = [] if place else [field.encode_name for field in msgspec.structs.fields(kind)]
        return f"{inside}unknown key {unknown[1]!r}" + (f"; allowed: {', '.join(known)}" if known else "")
    value = _value(tree, place)
    rule = _rule(problem, kind, place)
    if of_key:
        keys = value if isinstance(value, dict) else {}
        bad = [k for k in keys if not isinstance(k, str)]
        return f"{name}: the name {bad[0]!r} must be {rule}" if bad else f"{name}: a name must be {rule}"
    shown = "" if value is _NOTHING else f" is {_short(value)}; it"
    return f"{name}{shown} must be {rule}"


_NOTHING = object()


def _rule(problem: str, kind: type, place: str) -> str:
    if problem.startswith("Invalid enum value"):
        field = next((f for f in msgspec.structs.fields(kind) if f.name == place), None)
        values = getattr(field.type if field else None, "__args__", ())
        return f"one of {', '.join(map(str, values))}" if values else "another word"
    kinds, _, bound = re.sub(r", got .*", "", problem.removeprefix("Expected ")).partition("` ")
    words = " or ".join(_KINDS.get(k, k) for k in kinds.strip("`").split(" | "))
    if length := re.match(r"of length >= (\d+)", bound):
        return f"{words} with at least {length[1]} {'character' if kinds == '`str' else 'entry'}"
    bound = re.sub(r"\.0$", "", bound)
    for sign, said in ((">=", "at least"), ("<=", "at most"), (">", "above"), ("<", "below")):
        bound = re.sub(rf"^{sign} ", f"{said} ", bound)
    return f"{words} {bound}".strip()


def _value(tree: Any, place: str) -> Any:
    """What stands at ``a.b[0]``; `_NOTHING` where the place has no such name."""
    for part in re.findall(r"[^.\[\]]+", place):
        try:
            tree = tree[int(part)] if isinstance(tree, list) else tree[part]
        except (KeyError, IndexError, TypeError, ValueError):
            return _NOTHING
    return tree


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def json_ready(value: Any) -> Any:
    """``value`` with non-finite numbers as None, numpy scalars as plain ones, dataclasses as dicts, paths as text, at any depth."""
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_plain))


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if getattr(value, "ndim", None) == 0:  # numpy scalar
        return value.item()
    raise TypeError(f"{type(value).__name__} has no form in JSON")
