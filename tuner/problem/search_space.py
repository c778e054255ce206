"""Search spaces: named parameters on ``MissionConfig`` paths, and their unit cube.

The unit cube has one dimension per parameter: floats and integers are scaled (after the logarithm where
``scale: log``), a categorical choice sits at the centre of its bin. Samplers work in the cube.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from nbv.config import MissionConfig, parameter
from nbv.errors import UserError
from nbv.types import Bools, Floats
from tuner.problem.instances import Instance, rocks_of

Value = float | int | str | bool
Values = dict[str, Any]
Kind = Literal["float", "int", "categorical"]
Scale = Literal["linear", "log"]

# From so many parameters on most of them are expected to be without effect: 64 missions cannot tell which of 14
# matter otherwise (docs/results/index.md).
MANY_PARAMETERS = 14
# What only the planner of a mission reads: without effect where no view is planned.
PLANNERS = (
    *("gate.", "covis.", "b_aware.", "predicted."),
    *(
        "pool.min_altitude_m",
        "pool.max_altitude_m",
        "pool.max_elevation_deg",
        "pool.max_travel_m",
        "pool.min_spacing_m",
    ),
    *("pool.revisit_exclusion_m", "pool.azimuth_sectors", "pool.max_candidates"),
)
# What nothing reads where the seeds fly the paper's rings; their distance is the paper's, too.
_NOT_ON_RINGS = ("seed.lowest_deg", "seed.span_deg", "seed.upper_share", "seed.radius_m")

SEEDS, PHOTOGRAPHS = "seeds", "photographs"
CHOICE_JUMP = 0.2  # probability of another choice where a configuration is moved a little


@dataclass(frozen=True)
class Parameter:
    """One tuned quantity: a path on ``MissionConfig`` and its admissible values.

    ``low`` and ``high`` are inclusive and in the parameter's own unit (see ``nbv.config``); a categorical
    parameter has ``choices`` instead.
    """

    path: str
    kind: Kind
    low: float = 0.0
    high: float = 1.0
    scale: Scale = "linear"
    choices: tuple[Value, ...] = ()
    default: Value | None = None  # None: the base configuration's value
    also: tuple[str, ...] = ()  # further paths that take the same value

    def contains(self, value: Any) -> bool:
        if self.kind == "categorical":
            return value in self.choices
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        return self.low <= value <= self.high and (self.kind == "float" or float(value).is_integer())

    def to_unit(self, value: Any) -> float:
        if self.kind == "categorical":
            return (self.choices.index(value) + 0.5) / len(self.choices)
        low, high, number = self.low, self.high, float(value)
        if self.scale == "log":
            low, high, number = math.log(low), math.log(high), math.log(number)
        return min(1.0, max(0.0, (number - low) / (high - low)))

    @property
    def ends(self) -> tuple[Any, ...]:
        return self.choices if self.kind == "categorical" else (self.from_unit(0.0), self.from_unit(1.0))

    def from_unit(self, position: float) -> Any:
        """Return the value at ``position``, clipped to [0, 1]; integers are rounded, choices are binned."""
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
    begin: tuple[Values, ...] = ()  # run right after the default: where they differ from it

    @property
    def dimension(self) -> int:
        return len(self.parameters)

    @property
    def size(self) -> float:
        """Number of configurations; infinite where a parameter is continuous."""
        return math.prod(
            math.inf if p.kind == "float" else len(p.choices) or p.high - p.low + 1 for p in self.parameters
        )

    @property
    def paths(self) -> tuple[str, ...]:
        return tuple(p.path for p in self.parameters)

    def base_config(self, preset: MissionConfig, overrides: Mapping[str, Any] | None = None) -> MissionConfig:
        """Return ``preset`` with the space's own defaults, the overrides, and the fixed values, at once: one may need another."""
        own = {p.path: p.default for p in self.parameters if p.default is not None}
        return preset.with_values({**self.complete(own), **(overrides or {}), **self.base})

    def fitted(self, preset: MissionConfig) -> SearchSpace:
        """Return the space with its defaults written out, in which at most all photographs are seeds.

        `UserError` where there are never so few photographs as the fewest seeds.
        """
        base = self.base_config(preset)
        known, number = {p.path: p for p in self.parameters}, base.photographs
        seeds, searched = known.get(SEEDS), known.get(PHOTOGRAPHS)
        fewest = searched.low if searched is not None else number
        if seeds is not None and (seeds.low > fewest or seeds.low == number):
            raise UserError(
                f"search space {self.name!r}: seeds begins at {seeds.low:g}, and a mission takes {fewest:g} photographs; lower it"
            )
        of_number = {PHOTOGRAPHS: number} if seeds is not None and searched is None else {}

        def fit(p: Parameter) -> Parameter:
            most = min(p.high, number) if of_number and p is seeds else p.high
            default = value_at(base, p.path) if p.default is None else p.default
            return dataclasses.replace(p, default=default, high=most)

        parameters = tuple(map(fit, self.parameters))
        # A beginning with more seeds than there are photographs is left out.
        begin = tuple(b for b in self.begin if all(p.contains(b.get(p.path, p.default)) for p in parameters))
        return dataclasses.replace(self, parameters=parameters, base={**self.base, **of_number}, begin=begin)

    def with_defaults(self, values: Mapping[str, Any]) -> SearchSpace:
        """Return the space with these values, by path, in the place of its own defaults."""
        parameters = [
            p if p.default is None else dataclasses.replace(p, default=values.get(p.path, p.default))
            for p in self.parameters
        ]
        return dataclasses.replace(self, parameters=tuple(parameters))

    def config(self, preset: MissionConfig, values: Mapping[str, Any]) -> MissionConfig:
        return preset.with_values({**self.base, **self.complete(values)})

    def complete(self, values: Mapping[str, Any]) -> Values:
        """Return ``values`` with the further paths that take the same (``also``): all that a configuration sets."""
        return {
            **values,
            **{path: values[p.path] for p in self.parameters for path in p.also if p.path in values},
        }

    def default(self, preset: MissionConfig) -> Values:
        """Return the default values: explicit ones, else the base configuration's (in every preset the paper's).

        Raises `UserError`: a default outside its bounds, or bounds that ``MissionConfig`` refuses.
        """
        base = self.base_config(preset)
        values: Values = {}
        for p in self.parameters:
            value = p.default if p.default is not None else value_at(base, p.path)
            if not p.contains(value):
                raise UserError(
                    f"search space {self.name!r}: {p.path} has the default {value!r}, outside "
                    f"{_range_text(p)}; widen the bounds or give an explicit default"
                )
            values[p.path] = value
        for p in self.parameters:
            for end in p.ends:
                self._require_mission(
                    base, {**values, p.path: end}, f"{p.path} = {end!r}", "narrow the bounds"
                )
        for begin in self.begin:
            self._require_mission(base, {**values, **begin}, f"begin {begin}", "change it")
        return values

    def require(self, values: Mapping[str, Any]) -> None:
        """Raise `UserError` where a value is of no parameter of the space, or outside of its range."""
        known = {p.path: p for p in self.parameters}
        for path, value in values.items():
            if path not in known:
                raise UserError(f"{path!r} is not in the search space; it has {', '.join(known)}")
            if not known[path].contains(value):
                raise UserError(
                    f"{path} is {value!r}, outside of the search space: {_range_text(known[path])}"
                )

    def contains(self, values: Mapping[str, Any]) -> bool:
        """Whether the values, of all parameters, are a configuration of the space."""
        return all(p.contains(values[p.path]) for p in self.parameters)

    def _require_mission(self, base: MissionConfig, values: Values, what: str, remedy: str) -> None:
        try:
            base.with_values(self.complete(self.settled(values)))
        except UserError as error:
            raise UserError(f"search space {self.name!r}: {what} is no mission: {error}; {remedy}") from error

    def to_unit(self, values: Mapping[str, Any]) -> Floats:
        """Return (d,) position of ``values`` in the unit cube."""
        return np.array([p.to_unit(values[p.path]) for p in self.parameters])

    def from_unit(self, position: Floats | Sequence[float]) -> Values:
        """Return the values at a (d,) position in the unit cube, `settled`."""
        if len(position) != self.dimension:
            raise ValueError(f"position has {len(position)} coordinates, the space {self.dimension}")
        return self.settled({p.path: p.from_unit(float(u)) for p, u in zip(self.parameters, position)})

    def settled(self, values: Values) -> Values:
        """Return ``values`` with no more seeds than photographs and, of a `fitted` space, with those at their default that nothing
        reads beside the others."""
        number, idle = values.get(PHOTOGRAPHS, self.base.get(PHOTOGRAPHS)), tuple[str, ...]()
        if number is not None and values.get(SEEDS, 0) >= number:
            values, idle = {**values, SEEDS: number}, PLANNERS
        if values.get("seed.layout") == "rings":
            idle += _NOT_ON_RINGS
        return {
            p.path: p.default if p.default is not None and p.path.startswith(idle) else values[p.path]
            for p in self.parameters
        }

    def snap(self, position: Floats) -> Floats:
        """Return (d,) nearest position that is exactly a configuration (integers and choices settle)."""
        return self.to_unit(self.from_unit(position))

    def redraw_choices(self, moved: Floats, origin: Floats, rng: np.random.Generator) -> Floats:
        """Return (..., d) ``moved`` with the choices of ``origin``, each drawn anew with probability ``CHOICE_JUMP``.

        Nothing is near a choice, so a small move cannot change one.
        """
        categorical = list(self.categorical_dimensions)
        choices = origin[..., categorical]
        jump = rng.random(choices.shape) < CHOICE_JUMP
        result = moved.copy()
        result[..., categorical] = np.where(jump, rng.random(choices.shape), choices)
        return result

    @property
    def discrete_dimensions(self) -> tuple[int, ...]:
        return tuple(i for i, p in enumerate(self.parameters) if p.kind != "float")

    @property
    def categorical_dimensions(self) -> tuple[int, ...]:
        return tuple(i for i, p in enumerate(self.parameters) if p.kind == "categorical")

    def to_dict(self) -> dict[str, Any]:
        """Return the YAML form; ``space_from_dict`` reads it back."""
        return {
            "name": self.name,
            "description": self.description,
            "base": dict(self.base),
            **({"begin": [dict(values) for values in self.begin]} if self.begin else {}),
            "parameters": {p.path: p.to_dict() for p in self.parameters},
        }


def value_at(config: MissionConfig, path: str) -> Any:
    """Return the value of a parameter path such as ``gate.d95_m``; ``UserError`` if there is no such path."""
    parameter(path)  # says which there are
    return attrgetter(path)(config)


def _range_text(parameter: Parameter) -> str:
    if parameter.kind == "categorical":
        return f"the choices {list(parameter.choices)}"
    return f"[{parameter.low:g}, {parameter.high:g}]"


# The parts of a search space whose best configuration is asked for by name.
#
# *Tuned gate* is what the paper proposes: thresholds, weights and the repairing scorer, with seeds, candidate pool and numbers as they
# are. *Tuned planner* may change seeds and pool besides, and plans at least `LEAST_PLANNED` views. A space that tunes no gate, or a
# goal with a limit, has one answer, *Tuned*.


TUNED, TUNED_GATE, TUNED_PLANNER = "tuned", "tuned-gate", "tuned-planner"
LEAST_PLANNED = 3  # views that a tuned planner plans
CHOOSES_VIEWS = ("gate.", "covis.", "b_aware.", "predicted.", "shared.", "plugins.", "stop.knn_region")


@dataclass(frozen=True)
class Region:
    """Part of a search space: some parameters are held, others have an upper bound."""

    name: str
    space: SearchSpace
    held: Values = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)

    def contains(self, values: Mapping[str, Any]) -> bool:
        """Return whether a configuration lies in the region."""
        return all(values[path] == value for path, value in self.held.items()) and all(
            values[path] <= bound for path, bound in self.at_most.items()
        )

    def inside(self, unit: Floats) -> Bools:
        """Return (n,) which of (n, d) unit positions lie in the region."""
        return np.all(np.abs(self.project(unit) - unit) < 1e-9, axis=-1)

    def project(self, unit: Floats) -> Floats:
        """Return (..., d) unit positions moved into the region, parameter by parameter."""
        moved = unit.copy()
        for i, p in enumerate(self.space.parameters):
            if p.path in self.held:
                moved[..., i] = p.to_unit(self.held[p.path])
            elif p.path in self.at_most:
                moved[..., i] = np.minimum(moved[..., i], p.to_unit(self.at_most[p.path]))
        return moved


def regions_of(space: SearchSpace, default: Values, *, limited: bool) -> tuple[Region, ...]:
    """Return the regions of a `fitted` space; ``limited``: whether the goal has a limit."""
    chooses = [path for path in space.paths if path.startswith(CHOOSES_VIEWS)]
    if limited or not chooses:
        return (Region(TUNED, space),)
    plan = {path: default[path] for path in space.paths if not path.startswith(CHOOSES_VIEWS)}
    gate = Region(TUNED_GATE, space, plan)
    if not plan:
        return (gate,)
    number = space.base.get(PHOTOGRAPHS)
    most = {SEEDS: number - LEAST_PLANNED} if number and SEEDS in space.paths else {}
    return gate, Region(TUNED_PLANNER, space, at_most=most)


@dataclass(frozen=True)
class Problem:
    """A trial is a configuration of ``space`` in one of the ``instances`` with one of the ``replicates``.

    This is all that samplers, the surrogate and the recommendation know of it.
    """

    space: SearchSpace
    instances: tuple[Instance, ...]  # training instances
    default: Values  # the configuration that everything starts from
    replicates: int = 1  # per instance
    # The plain plans that run beside what is searched, by strategy, the simplest first; the default is one of them.
    arms: Mapping[str, Values] = field(default_factory=dict)
    regions: tuple[Region, ...] = ()  # whose best configurations are asked for

    @property
    def answers(self) -> tuple[Region, ...]:
        """The regions; without one all of the space."""
        return self.regions or (Region(TUNED, self.space),)

    @property
    def rocks(self) -> tuple[str, ...]:
        return rocks_of(self.instances)

    @property
    def repeatable(self) -> tuple[Instance, ...]:
        """The instances in which a mission repeats exactly: no outcome is an outlier there."""
        return ()
