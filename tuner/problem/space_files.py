"""Search spaces from YAML files, named or by path (docs/how-to/own-space.md)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig, parameter, shipped_files
from nbv.config.declaration import value_of
from nbv.errors import UserError
from nbv.safe_files import is_file, read_yaml, require
from tuner.problem.search_space import Kind, Parameter, Scale, SearchSpace

MAX_PARAMETERS = 100
MAX_CHOICES = 50
MAX_BEGIN = 10
_PARAMETER_KEYS = ("kind", "low", "high", "scale", "choices", "default", "also")
_SPACE_KEYS = ("name", "description", "base", "begin", "parameters")


def available_search_spaces() -> dict[str, Path]:
    """Return the named spaces and their files."""
    return shipped_files("search_spaces")


def load_search_space(name_or_path: str | Path) -> SearchSpace:
    """Read a space by name (``gate``, ``gate_and_weights``) or from a YAML file.

    Raises `UserError`: no such space, or a mistake in the file.
    """
    text = str(name_or_path)
    named = available_search_spaces()
    path = named[text] if text in named else Path(text)
    if text not in named and not (path.suffix in (".yaml", ".yml") or is_file(path)):
        raise UserError(
            f"unknown search space {text!r}; there are {', '.join(named) or 'none'}, or give a YAML file"
        )
    return space_from_dict(read_yaml(path), str(path))


def space_from_dict(tree: Any, source: str) -> SearchSpace:
    """Build and check a space from its YAML tree.

    Raises `UserError`: unknown key or parameter path, bad bounds or default, no parameters.
    """
    if not isinstance(tree, dict):
        raise UserError(f"{source}: a search space is a mapping with the key 'parameters'")
    _known_keys(tree, _SPACE_KEYS, source)
    raw = tree.get("parameters")
    if not isinstance(raw, dict) or not raw:
        raise UserError(f"{source}: 'parameters' must name at least one parameter")
    base = tree.get("base") or {}
    if not isinstance(base, dict):
        raise UserError(f"{source}: 'base' must map parameter paths to values")
    require(len(raw), MAX_PARAMETERS, f"{source}: the number of parameters")
    parameters = tuple(_parameter(path, spec, f"{source}: {path}") for path, spec in raw.items())
    tuned = [path for p in parameters for path in (p.path, *p.also)]
    for path in tuned:
        try:
            parameter(path)
        except UserError as error:
            raise UserError(f"{source}: {error}") from error
        if path in base:
            raise UserError(f"{source}: {path} is both fixed in 'base' and tuned; remove one of the two")
        if tuned.count(path) > 1:
            raise UserError(
                f"{source}: {path} is tuned twice, as a parameter and in 'also'; remove one of the two"
            )
    begin = tree.get("begin") or []
    if not isinstance(begin, list) or not all(isinstance(values, dict) for values in begin):
        raise UserError(f"{source}: 'begin' must list mappings from parameter paths to values")
    require(len(begin), MAX_BEGIN, f"{source}: the number of configurations in 'begin'")
    space = SearchSpace(
        str(tree.get("name") or Path(source).stem),
        parameters,
        base,
        str(tree.get("description") or ""),
        tuple(begin),
    )
    for values in begin:
        try:
            space.require(values)
        except UserError as error:
            raise UserError(f"{source}: begin: {error}") from error
    try:
        space.base_config(MissionConfig())
    except UserError as error:
        raise UserError(f"{source}: base: {error}") from error
    return space


def _known_keys(tree: dict[Any, Any], allowed: Sequence[str], where: str) -> None:
    for key in tree:
        if key not in allowed:
            raise UserError(f"{where}: unknown key {key!r}; allowed: {', '.join(allowed)}")


def _parameter(path: str, spec: Any, where: str) -> Parameter:
    if not isinstance(spec, dict):
        raise UserError(f"{where}: give a mapping such as {{kind: float, low: 0.1, high: 1.0}}")
    _known_keys(spec, _PARAMETER_KEYS, where)
    kind = value_of(Kind, spec.get("kind", "float"), f"{where}: kind")
    for key in ("low", "high", "scale") if kind == "categorical" else ("choices",):
        if key in spec:
            raise UserError(f"{where}: {key!r} does not belong to kind {kind}")
    also = value_of(tuple[str, ...], spec.get("also", []), f"{where}: also")
    if kind == "categorical":
        raw = spec.get("choices")
        if not isinstance(raw, list) or len(raw) < 2:
            raise UserError(f"{where}: 'choices' must list at least two values")
        require(len(raw), MAX_CHOICES, f"{where}: the number of choices")
        if any(not isinstance(choice, (str, int, float, bool)) for choice in raw):
            raise UserError(f"{where}: each choice must be a string, a number or a boolean")
        for one, other in itertools.combinations(raw, 2):
            if one == other or str(one) == str(other):  # a model would learn each by itself
                same = "is given twice" if repr(one) == repr(other) else f"and {other!r} are one value"
                raise UserError(f"{where}: among the choices {one!r} {same}; list each value once")
        return Parameter(path, kind, choices=tuple(raw), default=spec.get("default"), also=also)
    number = int if kind == "int" else float
    for key in ("low", "high"):
        if spec.get(key) is None:
            raise UserError(f"{where}: {key!r} is missing; kind {kind} needs low and high")
    low, high = (value_of(number, spec.get(key), f"{where}: {key}") for key in ("low", "high"))
    if low >= high:
        raise UserError(f"{where}: low {low:g} is not below high {high:g}; swap or widen the bounds")
    scale = value_of(Scale, spec.get("scale", "linear"), f"{where}: scale")
    if scale == "log" and low <= 0:
        raise UserError(f"{where}: scale log needs low above 0, not {low:g}; raise low or use scale linear")
    return Parameter(path, kind, low, high, scale, (), spec.get("default"), also)
