"""What a mission that is not ours takes and gives: its file, checked."""

from __future__ import annotations

import collections
import hashlib
import itertools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nbv.errors import UserError
from nbv.safe_files import is_file, parse_yaml, read_bytes
from tuner.missions.external.checking import check
from tuner.missions.external.program import program_digest
from tuner.problem.objective import Direction, Objective
from tuner.problem.search_space import Parameter, SearchSpace, Values

_LAST_PORT = 65535


@dataclass(frozen=True)
class Instance:
    """One rock, scene or vehicle: whatever the mission flies on."""

    name: str
    facts: dict[str, Any] = field(default_factory=dict)  # further keys of the file, handed to the mission

    def to_dict(self) -> dict[str, Any]:
        """As a request has it."""
        return {"name": self.name, **self.facts}


@dataclass(frozen=True)
class Resource:
    """What each slot owns one of: numbered from ``first`` in steps, or a folder."""

    kind: Literal["port", "number", "folder"]
    first: int = 0
    step: int = 1

    def of(self, slot: int) -> int:
        """The number of a slot."""
        return self.first + slot * self.step


@dataclass(frozen=True)
class MissionFile:
    """A checked mission file; `load_mission_file` reads one."""

    path: Path  # absolute; commands run in its folder, meshes are relative to it
    name: str
    command: tuple[str, ...]  # empty where ``function`` is given
    function: str  # module:function, or empty
    space: SearchSpace
    instances: tuple[Instance, ...]
    held_out: tuple[Instance, ...]
    objective: Objective
    replicates: int = 1
    baselines: dict[str, Values] = field(default_factory=dict)
    time_limit_s: float = 3600.0
    stop_grace_s: float = 5.0
    retries: int = 1
    at_once: int = 1
    resources: dict[str, Resource] = field(default_factory=dict)
    score: dict[str, Any] | None = None
    description: str = ""
    directions: dict[str, Direction] = field(
        default_factory=dict
    )  # of ``metric`` and of further metrics and costs
    sha256: str = ""  # of the file's bytes
    program: str = ""  # hash of what it runs, see `tuner.missions.external.program`

    @property
    def folder(self) -> Path:
        """Where commands run."""
        return self.path.parent

    def instance(self, name: str) -> Instance:
        """The instance called ``name``, of those to tune on or of those held out; ``UserError`` if there is none."""
        for instance in (*self.instances, *self.held_out):
            if instance.name == name:
                return instance
        known = ", ".join(i.name for i in (*self.instances, *self.held_out))
        raise UserError(f"{self.path} has no instance {name!r}; there are {known}")

    def defaults(self) -> Values:
        """The default of every parameter."""
        return {parameter.path: parameter.default for parameter in self.space.parameters}


def load_mission_file(path: Path) -> MissionFile:
    """Read and check a mission file.

    Raises
    ------
    UserError
        Not readable, not YAML, against the schema, or at odds with itself: one line that names the place.
    """
    path = path.resolve()
    source = str(path)
    if not is_file(path):
        raise UserError(f"{source} is not a file; gatetune mission init writes a skeleton")
    content = read_bytes(path)
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise UserError(f"{source} is not UTF-8 text; mend it") from error
    tree = parse_yaml(text, source)
    check(tree, "mission", source)
    _check_values(tree, source)
    parameters = tuple(_parameter(name, entry, source) for name, entry in tree["parameters"].items())
    space = SearchSpace(tree["name"], parameters, description=tree.get("description", ""))
    mission = MissionFile(
        path,
        tree["name"],
        tuple(tree.get("command", ())),
        tree.get("function", ""),
        space,
        tuple(_instance(entry) for entry in tree["instances"]),
        tuple(_instance(entry) for entry in tree.get("held_out", ())),
        Objective(tree["metric"], _direction(tree["direction"])),
        replicates=tree.get("replicates", 1),
        baselines={
            name: complete(space, values, f"{source}: baselines.{name}")
            for name, values in tree.get("baselines", {}).items()
        },
        time_limit_s=float(tree.get("time_limit_s", 3600.0)),
        stop_grace_s=float(tree.get("stop_grace_s", 5.0)),
        retries=tree.get("retries", 1),
        at_once=tree.get("at_once", 1),
        resources={name: Resource(**entry) for name, entry in tree.get("resources", {}).items()},
        score=tree.get("score"),
        description=tree.get("description", ""),
        directions={
            tree["metric"]: _direction(tree["direction"]),
            **{name: _direction(text) for name, text in tree.get("directions", {}).items()},
        },
        sha256=hashlib.sha256(content).hexdigest(),
        program=_program(path, tree),
    )
    _check_names(mission, source)
    _check_variables(mission, source)
    _check_ports(mission, source)
    return mission


def _program(path: Path, tree: Mapping[str, Any]) -> str:
    try:
        return program_digest(path.parent, tree.get("command", ()), tree.get("function", ""))
    except OSError as error:
        raise UserError(f"{path}: cannot read its program: {error}; make it readable") from error


def _direction(text: str) -> Direction:
    return "maximise" if text == "maximise" else "minimise"


def _instance(entry: str | Mapping[str, Any]) -> Instance:
    if isinstance(entry, str):
        return Instance(entry)
    return Instance(entry["name"], {key: value for key, value in entry.items() if key != "name"})


def _parameter(name: str, entry: Mapping[str, Any], source: str) -> Parameter:
    where = f"{source}: parameters.{name}"
    kind = entry["kind"]
    if kind == "categorical":
        parameter = Parameter(name, "categorical", choices=tuple(entry["choices"]), default=entry["default"])
    else:
        low, high, scale = entry["low"], entry["high"], entry.get("scale", "linear")
        if not low < high:
            raise UserError(f"{where}: low is {low:g} and high {high:g}; low must be less")
        if scale == "log" and low <= 0:
            raise UserError(f"{where}: scale log needs a low above 0, not {low:g}")
        parameter = Parameter(name, kind, float(low), float(high), scale, default=entry["default"])
        if kind == "int":
            parameter = Parameter(name, kind, int(low), int(high), scale, default=entry["default"])
    if not parameter.contains(entry["default"]):
        raise UserError(f"{where}: the default {entry['default']!r} is not among its values")
    return parameter


def complete(space: SearchSpace, values: Mapping[str, Any], source: str) -> Values:
    """``values``, with the defaults of what they do not name; `UserError` for a name or a value that there is not."""
    parameters = {parameter.path: parameter for parameter in space.parameters}
    for name, value in values.items():
        if name not in parameters:
            raise UserError(f"{source}: unknown parameter {name!r}; there are {', '.join(parameters)}")
        if not parameters[name].contains(value):
            raise UserError(f"{source}: {name} = {value!r} is not among its values")
    return {path: values.get(path, parameter.default) for path, parameter in parameters.items()}


def _check_values(tree: Any, source: str, place: str = "") -> None:
    """Numbers are finite; texts fit into an environment."""
    if isinstance(tree, (dict, list)):
        for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
            _check_values(key, source, place or str(key))
            _check_values(value, source, f"{place}.{key}" if place else str(key))
    elif isinstance(tree, float) and not math.isfinite(tree):
        raise UserError(f"{source}: {place} is {tree:g}; every number must be finite")
    elif isinstance(tree, str) and "\0" in tree:
        raise UserError(f"{source}: {place} holds a zero byte; take it out")


def variable_of(parameter: str) -> str:
    """The environment variable that hands a parameter to the mission."""
    return "PARAMETER_" + re.sub(r"[^A-Za-z0-9]", "_", parameter)


def _check_variables(mission: MissionFile, source: str) -> None:
    """Every parameter has an environment variable of its own."""
    owners: dict[str, str] = {}
    for name in mission.defaults():
        if (other := owners.setdefault(variable_of(name), name)) != name:
            raise UserError(
                f"{source}: parameters {other!r} and {name!r} would both be {variable_of(name)} in the mission's "
                "environment; rename one"
            )


def _check_names(mission: MissionFile, source: str) -> None:
    metric = mission.objective.metric
    if mission.directions[metric] != mission.objective.direction:
        raise UserError(f"{source}: directions says otherwise of {metric!r} than direction; leave one out")
    names = [instance.name for instance in (*mission.instances, *mission.held_out)]
    twice = [name for name, count in collections.Counter(names).items() if count > 1]
    if twice:
        raise UserError(
            f"{source}: instance {twice[0]!r} is named twice; what is held out must not be tuned on"
        )
    if mission.score is not None:
        for instance in (*mission.instances, *mission.held_out):
            if "mesh" not in instance.facts:
                raise UserError(
                    f"{source}: 'score' measures clouds against a mesh; instance {instance.name!r} has none"
                )


def _check_ports(mission: MissionFile, source: str) -> None:
    """No two slots, and no two resources, may own the same port."""
    owned: dict[int, str] = {}
    for (name, resource), slot in itertools.product(mission.resources.items(), range(mission.at_once)):
        if resource.kind != "port":
            continue
        port, owner = resource.of(slot), f"{name} of slot {slot}"
        if not 1 <= port <= _LAST_PORT:
            raise UserError(
                f"{source}: resources.{name}: slot {slot} would get port {port}; ports go from 1 to 65535"
            )
        if port in owned:
            raise UserError(
                f"{source}: port {port} would belong to {owned[port]} and to {owner}; choose other numbers"
            )
        owned[port] = owner
