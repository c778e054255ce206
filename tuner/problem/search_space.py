"""Search spaces: YAML to named parameters on ``MissionConfig`` paths, and their unit cube.

A search space file reads::

    name: gate
    base:                       # optional: fixed values laid over the preset
      gate.kind: hyb-h
    parameters:
      gate.d95_m: {kind: float, low: 0.01, high: 1.0, scale: log}       # default: the preset's value
      b_aware.target_track_length: {kind: int, low: 3, high: 12}
      visibility.mode: {kind: categorical, choices: [frustum, occlusion]}
      b_aware.weights.nov: {kind: float, low: 0.1, high: 2.0, also: [matchable.weights.nov]}  # one value for both

The unit cube has one dimension per parameter: floats and integers are scaled (after the logarithm where
``scale: log``), a categorical choice sits at the centre of its bin. Samplers work in the cube.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from nbv.config import MissionConfig, parameter_paths
from nbv.errors import UserError
from nbv.types import Floats

Value = float | int | str | bool
Values = dict[str, Any]

_PARAMETER_KEYS = ("kind", "low", "high", "scale", "choices", "default", "also")
CHOICE_JUMP = 0.2  # probability of another choice where a configuration is moved a little
_SPACE_KEYS = ("name", "description", "base", "parameters")


@dataclass(frozen=True)
class Parameter:
    """One tuned quantity: a path on ``MissionConfig`` and its admissible values.

    ``low`` and ``high`` are inclusive and in the parameter's own unit (see ``nbv.config``); a categorical
    parameter has ``choices`` instead.
    """

    path: str
    kind: Literal["float", "int", "categorical"]
    low: float = 0.0
    high: float = 1.0
    scale: Literal["linear", "log"] = "linear"
    choices: tuple[Value, ...] = ()
    default: Value | None = None  # None: the base configuration's value
    also: tuple[str, ...] = ()  # further paths that take the same value

    def contains(self, value: Any) -> bool:
        """Whether ``value`` is admissible."""
        if self.kind == "categorical":
            return value in self.choices
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        return self.low <= value <= self.high and (self.kind == "float" or float(value).is_integer())

    def to_unit(self, value: Any) -> float:
        """Position of ``value`` in [0, 1]."""
        if self.kind == "categorical":
            return (self.choices.index(value) + 0.5) / len(self.choices)
        low, high, number = self.low, self.high, float(value)
        if self.scale == "log":
            low, high, number = math.log(low), math.log(high), math.log(number)
        return min(1.0, max(0.0, (number - low) / (high - low)))

    @property
    def ends(self) -> tuple[Any, ...]:
        """Both bounds, or all choices."""
        return self.choices if self.kind == "categorical" else (self.from_unit(0.0), self.from_unit(1.0))

    def from_unit(self, position: float) -> Any:
        """Value at ``position``, clipped to [0, 1]; integers are rounded, choices are binned."""
        position = min(1.0, max(0.0, float(position)))
        if self.kind != "categorical" and position in (0.0, 1.0):  # exactly, whatever exp and log round to
            return self.high if position else self.low
        if self.kind == "categorical":
            return self.choices[min(int(position * len(self.choices)), len(self.choices) - 1)]
        if self.scale == "log":
            low, high = math.log(self.low), math.log(self.high)
            number = math.exp(low + position * (high - low))
        else:
            number = self.low + position * (self.high - self.low)
        number = min(self.high, max(self.low, number))
        return round(number) if self.kind == "int" else number

    def to_dict(self) -> dict[str, Any]:
        """The YAML form."""
        tree: dict[str, Any] = {"kind": self.kind}
        if self.kind == "categorical":
            tree["choices"] = list(self.choices)
        else:
            tree.update(low=self.low, high=self.high, scale=self.scale)
        if self.default is not None:
            tree["default"] = self.default
        if self.also:
            tree["also"] = list(self.also)
        return tree


@dataclass(frozen=True)
class SearchSpace:
    """Named parameters, in file order, and the fixed values that go with them."""

    name: str
    parameters: tuple[Parameter, ...]
    base: dict[str, Any] = field(default_factory=dict)
    description: str = ""

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def paths(self) -> tuple[str, ...]:
        """Parameter paths in order."""
        return tuple(parameter.path for parameter in self.parameters)

    def base_config(self, preset: MissionConfig) -> MissionConfig:
        """``preset`` with the space's fixed values."""
        return preset.with_values(self.base)

    def config(self, preset: MissionConfig, values: Mapping[str, Any]) -> MissionConfig:
        """The mission configuration at ``values``."""
        return preset.with_values({**self.base, **self.complete(values)})

    def complete(self, values: Mapping[str, Any]) -> Values:
        """``values`` with the further paths that take the same (``also``): all that a configuration sets."""
        return {
            **values,
            **{path: values[p.path] for p in self.parameters for path in p.also if p.path in values},
        }

    def default(self, preset: MissionConfig) -> Values:
        """Default values: explicit ones, else the base configuration's (in every preset the paper's).

        Raises
        ------
        UserError
            A default outside its bounds, or bounds that ``MissionConfig`` refuses.
        """
        base = self.base_config(preset)
        values: Values = {}
        for parameter in self.parameters:
            value = parameter.default if parameter.default is not None else value_at(base, parameter.path)
            if not parameter.contains(value):
                raise UserError(
                    f"search space {self.name!r}: {parameter.path} has the default {value!r}, outside "
                    f"{_range_text(parameter)}; widen the bounds or give an explicit default"
                )
            values[parameter.path] = value
        for parameter in self.parameters:
            self._require_missions(base, values, [parameter])
        return values

    def check_pairs(self, preset: MissionConfig) -> None:
        """Whether every two parameters may be anything at once; what excludes combinations, such as an order, does so for two.

        Raises
        ------
        UserError
            As ``default``, or bounds of two parameters that ``MissionConfig`` refuses together: a sampler that comes
            there would end the campaign.
        """
        base, values = self.base_config(preset), self.default(preset)
        for pair in itertools.combinations(self.parameters, 2):
            self._require_missions(base, values, pair)

    def _require_missions(self, base: MissionConfig, values: Values, parameters: Sequence[Parameter]) -> None:
        for ends in itertools.product(*(p.ends for p in parameters)):
            changed = {p.path: value for p, value in zip(parameters, ends)}
            try:
                base.with_values(self.complete({**values, **changed}))
            except UserError as error:
                text = " with ".join(f"{path} = {value!r}" for path, value in changed.items())
                raise UserError(
                    f"search space {self.name!r}: {text} is no mission: {error}; narrow the bounds"
                ) from error

    def to_unit(self, values: Mapping[str, Any]) -> Floats:
        """(d,) position of ``values`` in the unit cube."""
        return np.array([parameter.to_unit(values[parameter.path]) for parameter in self.parameters])

    def from_unit(self, position: Floats | Sequence[float]) -> Values:
        """Values at a (d,) position in the unit cube."""
        if len(position) != self.dimension:
            raise ValueError(f"position has {len(position)} coordinates, the space {self.dimension}")
        return {p.path: p.from_unit(float(u)) for p, u in zip(self.parameters, position)}

    def snap(self, position: Floats) -> Floats:
        """(d,) nearest position that is exactly a configuration (integers and choices settle)."""
        return self.to_unit(self.from_unit(position))

    def redraw_choices(self, moved: Floats, origin: Floats, rng: np.random.Generator) -> Floats:
        """(..., d) ``moved`` with the choices of ``origin``, each drawn anew with probability ``CHOICE_JUMP``.

        Nothing is near a choice, so a small move cannot change one.
        """
        categorical = list(self.categorical_dimensions)
        kept = origin[..., categorical]
        jump = rng.random(kept.shape) < CHOICE_JUMP
        result = moved.copy()
        result[..., categorical] = np.where(jump, rng.random(kept.shape), kept)
        return result

    @property
    def discrete_dimensions(self) -> tuple[int, ...]:
        """Indices of integer and categorical parameters."""
        return tuple(i for i, p in enumerate(self.parameters) if p.kind != "float")

    @property
    def categorical_dimensions(self) -> tuple[int, ...]:
        """Indices of categorical parameters."""
        return tuple(i for i, p in enumerate(self.parameters) if p.kind == "categorical")

    def to_dict(self) -> dict[str, Any]:
        """The YAML form; ``space_from_dict`` reads it back."""
        return {
            "name": self.name,
            "description": self.description,
            "base": dict(self.base),
            "parameters": {parameter.path: parameter.to_dict() for parameter in self.parameters},
        }


def value_at(config: MissionConfig, path: str) -> Any:
    """The value of a parameter path such as ``gate.d95_m``; ``UserError`` if there is no such path."""
    node: Any = config
    for part in path.split("."):
        if not hasattr(node, part):
            config.with_values({path: None})  # names the nearest paths
        node = getattr(node, part)
    return node


def _range_text(parameter: Parameter) -> str:
    if parameter.kind == "categorical":
        return f"the choices {list(parameter.choices)}"
    return f"[{parameter.low:g}, {parameter.high:g}]"


# -- files ---------------------------------------------------------------------------------------------------


def search_space_directories() -> tuple[Path, ...]:
    """Where named spaces are looked for: beside the package (a clone), then the installed data files."""
    beside = Path(__file__).resolve().parents[2] / "search_spaces"
    installed = Path(sys.prefix) / "share" / "gatetune" / "search_spaces"
    return (beside, installed)


def available_search_spaces() -> dict[str, Path]:
    """Named spaces and their files."""
    found: dict[str, Path] = {}
    for directory in search_space_directories():
        for file in sorted(directory.glob("*.yaml")):
            found.setdefault(file.stem, file)
    return found


def load_search_space(name_or_path: str | Path) -> SearchSpace:
    """Read a space by name (``gate``, ``gate_and_weights``) or from a YAML file.

    Raises
    ------
    UserError
        No such space, or a mistake in the file.
    """
    text = str(name_or_path)
    named = available_search_spaces()
    path = named[text] if text in named else Path(text)
    if text not in named and not (path.suffix in (".yaml", ".yml") or path.exists()):
        raise UserError(
            f"unknown search space {text!r}; there are {', '.join(named) or 'none'}, or give a YAML file"
        )
    try:
        content = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"cannot read search space {path}: {error}; give a readable YAML file") from error
    return parse_search_space(content, str(path))


class _UniqueKeyLoader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice, where YAML would keep the last one silently."""


def _unique_mapping(loader: _UniqueKeyLoader, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
    seen: set[Any] = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if isinstance(key, (list, dict)):
            continue
        if key in seen:
            raise yaml.constructor.ConstructorError(None, None, f"duplicate key {key!r}", key_node.start_mark)
        seen.add(key)
    return loader.construct_mapping(node, deep=True)


_UniqueKeyLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def parse_search_space(text: str, source: str) -> SearchSpace:
    """Parse YAML text; ``source`` names it in messages."""
    try:
        tree = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}" if mark is not None else ""
        raise UserError(f"{source}{line}: {error.problem or error.context}; mend the YAML") from error
    except yaml.YAMLError as error:
        raise UserError(f"{source}: not YAML ({str(error).splitlines()[0]}); mend it") from error
    space = space_from_dict(tree, source)
    space.check_pairs(MissionConfig())  # here: a campaign that flew without the check can still be read
    return space


def space_from_dict(tree: Any, source: str) -> SearchSpace:
    """Build and check a space from its YAML tree.

    Raises
    ------
    UserError
        Unknown key or parameter path, bad bounds or default, no parameters.
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
    for path in (*raw, *base):
        _known_path(str(path), source)
    parameters = tuple(_parameter(path, spec, f"{source}: {path}") for path, spec in raw.items())
    tuned = [path for p in parameters for path in (p.path, *p.also)]
    for path in tuned:
        _known_path(path, source)
        if path in base:
            raise UserError(f"{source}: {path} is both fixed in 'base' and tuned; remove one of the two")
        if tuned.count(path) > 1:
            raise UserError(
                f"{source}: {path} is tuned twice, as a parameter and in 'also'; remove one of the two"
            )
    space = SearchSpace(
        str(tree.get("name") or Path(source).stem), parameters, dict(base), str(tree.get("description") or "")
    )
    try:
        space.base_config(MissionConfig())
    except UserError as error:
        raise UserError(f"{source}: base: {error}") from error
    space.default(MissionConfig())  # checks defaults and both ends of every range
    return space


def _known_keys(tree: dict[Any, Any], allowed: Sequence[str], where: str) -> None:
    for key in tree:
        if key not in allowed:
            raise UserError(f"{where}: unknown key {key!r}; allowed: {', '.join(allowed)}")


def _known_path(path: str, source: str) -> None:
    if path not in parameter_paths():
        try:
            MissionConfig().with_values({path: None})
        except UserError as error:
            raise UserError(f"{source}: {error}") from error


def _parameter(path: str, spec: Any, where: str) -> Parameter:
    if not isinstance(spec, dict):
        raise UserError(f"{where}: give a mapping such as {{kind: float, low: 0.1, high: 1.0}}")
    _known_keys(spec, _PARAMETER_KEYS, where)
    also = spec.get("also", [])
    if not isinstance(also, list) or any(not isinstance(other, str) for other in also):
        raise UserError(f"{where}: 'also' must list parameter paths, not {also!r}")
    return dataclasses.replace(_range(path, spec, where), also=tuple(also))


def _range(path: str, spec: dict[str, Any], where: str) -> Parameter:
    kind = spec.get("kind", "float")
    if kind not in ("float", "int", "categorical"):
        raise UserError(f"{where}: unknown kind {kind!r}; allowed: float, int, categorical")
    default = spec.get("default")
    if kind == "categorical":
        return _categorical(path, spec, default, where)
    if "choices" in spec:
        raise UserError(f"{where}: 'choices' belongs to kind categorical; give low and high")
    for key in ("low", "high"):
        value = spec.get(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise UserError(f"{where}: '{key}' must be a finite number, not {value!r}")
        if kind == "int" and not float(value).is_integer():
            raise UserError(f"{where}: '{key}' must be a whole number for kind int, not {value!r}")
    low, high = float(spec["low"]), float(spec["high"])
    if low >= high:
        raise UserError(f"{where}: low {low:g} is not below high {high:g}; swap or widen the bounds")
    scale = spec.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise UserError(f"{where}: unknown scale {scale!r}; allowed: linear, log")
    if scale == "log" and low <= 0:
        raise UserError(f"{where}: scale log needs low above 0, not {low:g}; raise low or use scale linear")
    if kind == "int":
        return Parameter(path, "int", int(low), int(high), scale, (), default)
    return Parameter(path, "float", low, high, scale, (), default)


def _categorical(path: str, spec: dict[str, Any], default: Any, where: str) -> Parameter:
    for key in ("low", "high", "scale"):
        if key in spec:
            raise UserError(f"{where}: '{key}' does not belong to kind categorical; give 'choices'")
    choices = spec.get("choices")
    if not isinstance(choices, list) or len(choices) < 2:
        raise UserError(f"{where}: 'choices' must list at least two values")
    if any(not isinstance(choice, (str, int, float, bool)) for choice in choices):
        raise UserError(f"{where}: each choice must be a string, a number or a boolean")
    if len({repr(choice) for choice in choices}) != len(choices):
        raise UserError(f"{where}: a choice is given twice; list each once")
    return Parameter(path, "categorical", choices=tuple(choices), default=default)
