"""A mission file: what a mission of the user's own takes and gives; and a configuration of it."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from nbv.config import IDEAL, config_from_dict
from nbv.convert import converted
from nbv.errors import UserError
from nbv.safe_files import is_file, read_bytes, read_yaml
from tuner.problem.objective import Direction, Objective
from tuner.problem.search_space import Configuration, SearchSpace, Values
from tuner.problem.space_files import parameter_from_dict

_VARIABLE = r"^[A-Za-z]\w*$"
_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_FUNCTION = r"^([A-Za-z_][\w.]*:[A-Za-z_]\w*)?$"
_RULES = {
    _VARIABLE: "a letter, then letters, digits and _, as a program's variable",
    _NAME: "at most 64 letters, digits, '_', '.' and '-', a letter or a digit first",
    _FUNCTION: "MODULE:FUNCTION, such as shots:fly",
}
_Count = Annotated[int, msgspec.Meta(ge=1)]
_Variable = Annotated[str, msgspec.Meta(pattern=_VARIABLE)]
_Some = msgspec.Meta(min_length=1)


class Score(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a result's cloud is measured."""

    set: dict[str, Any] = {}  # parameters that differ from preset ``campaign``
    frame: Literal["mesh", "rock"] = "mesh"  # the mesh file's own, or 1.6 m tall on the ground at the origin


class MissionFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a mission file; `load_mission_file` reads and checks one."""

    name: Annotated[str, msgspec.Meta(pattern=_NAME)]
    parameters: Annotated[dict[_Variable, Any], _Some]
    instances: Annotated[
        dict[str, dict[str, Any]], _Some
    ]  # rocks, scenes, vehicles, with what the file says of them
    metric: str
    direction: Direction
    command: tuple[str, ...] = ()
    function: Annotated[str, msgspec.Meta(pattern=_FUNCTION)] = ""
    held_out: dict[str, dict[str, Any]] = {}
    directions: dict[str, Direction] = {}  # of the metric, of further metrics and of costs
    baselines: dict[str, dict[str, Any]] = {}
    replicates: _Count = 1
    time_limit_s: Annotated[float, msgspec.Meta(gt=0)] = 3600.0
    at_once: _Count = 1  # missions side by side on one machine
    score: Score | None = None
    description: str = ""
    # What the loader adds:
    path: Path = Path()  # absolute; programs run in its folder, meshes are relative to it
    sha256: str = ""  # of the file
    program: str = ""  # hash of the files that ``command`` or ``function`` names

    @property
    def objective(self) -> Objective:
        """The metric that is tuned."""
        return Objective(self.metric, self.direction)

    @property
    def space(self) -> SearchSpace:
        """The search space that its ``parameters`` declare; `UserError` for a declaration that is not valid."""
        parameters = [
            parameter_from_dict(n, spec, f"{self.path}: {n}") for n, spec in self.parameters.items()
        ]
        for parameter in parameters:
            if parameter.also or parameter.default is None or not parameter.contains(parameter.default):
                raise UserError(
                    f"{self.path}: {parameter.path} needs a default among its values, and no 'also'"
                )
        return SearchSpace(self.name, tuple(parameters), description=self.description)

    def complete(self, values: Mapping[str, Any]) -> Values:
        """Return ``values`` and the defaults of what they leave out; `UserError` for an unknown name, or a value not allowed."""
        parameters = {parameter.path: parameter for parameter in self.space.parameters}
        for name, value in values.items():
            if name not in parameters:
                raise UserError(f"{self.path}: unknown parameter {name!r}; there are {', '.join(parameters)}")
            if not parameters[name].contains(value):
                raise UserError(f"{self.path}: {name} = {value!r} is not among its values")
        given = {name: values.get(name, p.default) for name, p in parameters.items()}
        # 1 and 1.0 are the same number and would be two configurations.
        return {name: parameters[name].as_declared(value) for name, value in given.items()}

    def instance(self, name: str) -> dict[str, Any]:
        """Return an instance with its name; ``UserError`` if there is none."""
        known = {**self.instances, **self.held_out}
        if name not in known:
            raise UserError(f"{self.path} has no instance {name!r}; there are {', '.join(known)}")
        return {"name": name, **known[name]}


def load_mission_file(path: Path, sha256: str = "") -> MissionFile:
    """Read and check a mission file; `UserError` where it cannot be read, makes no mission, or has another hash than ``sha256``."""
    path = path.resolve()
    if not is_file(path):
        raise UserError(f"{path} is not a file; gatetune mission init writes a skeleton")
    tree, digest = read_yaml(path), hashlib.sha256(read_bytes(path)).hexdigest()
    if sha256 not in ("", digest):
        raise UserError(
            f"{path} has changed since the campaign began; put it back as it was, or begin a new campaign"
        )
    for key in ("instances", "held_out"):
        if isinstance(tree, dict) and isinstance(tree.get(key), list):
            tree[key] = _by_name(tree[key], path)
    mission = converted(tree, MissionFile, str(path), _RULES)
    mission = msgspec.structs.replace(
        mission,
        path=path,
        sha256=digest,
        program=_program_digest(path.parent, mission),
        directions={**mission.directions, mission.metric: mission.direction},
    )
    _check(mission)
    return mission


def _by_name(entries: list[Any], path: Path) -> dict[str, dict[str, Any]]:
    by_name: dict[str, dict[str, Any]] = {}
    for entry in entries:
        facts = dict(entry) if isinstance(entry, dict) else {"name": entry}
        name = facts.pop("name", None)
        if not isinstance(name, str) or not name:
            raise UserError(f"{path}: instance {entry!r} has no name; quote one that is a number")
        if name in by_name:
            raise UserError(f"{path}: instance {name!r} is named twice")
        by_name[name] = facts
    return by_name


def _check(mission: MissionFile) -> None:
    path = mission.path
    try:
        _ = mission.objective
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    if bool(mission.command) == bool(mission.function):
        raise UserError(f"{path}: give either command or function")
    if both := mission.instances.keys() & mission.held_out.keys():
        raise UserError(f"{path}: {sorted(both)[0]!r} is an instance and held out; it may not be tuned on")
    for name, facts in {**mission.instances, **mission.held_out}.items():
        if mission.score and not isinstance(facts.get("mesh"), str):
            raise UserError(f"{path}: 'score' measures clouds against a mesh; instance {name!r} has none")
    for values in ({}, *mission.baselines.values()):
        mission.complete(values)


def _program_digest(folder: Path, mission: MissionFile) -> str:
    """Return the SHA-256 of the files in ``folder`` that ``command`` or ``function`` names."""
    module = mission.function.partition(":")[0].replace(".", "/")
    named = [folder / word for word in (*mission.command, f"{module}.py", f"{module}/__init__.py")]
    digest = hashlib.sha256()
    for path in named:
        if path.is_relative_to(folder) and is_file(path):
            digest.update(read_bytes(path, 2**30))
    return digest.hexdigest()


@dataclass(frozen=True)
class ExternalConfig:
    """A `Configuration` of a mission file; `external_config` makes one."""

    mission_file: str  # absolute path
    sha256: str  # of the file when the campaign began
    program: str  # its hash when the session began
    values: Mapping[str, Any]  # of every parameter, by its name

    condition: ClassVar[str] = IDEAL  # a mission file has instances for what differs

    @property
    def mission(self) -> MissionFile:
        """The mission file; ``UserError`` if it or its program is gone or has changed."""
        return _unchanged(self.mission_file, self.sha256, self.program)

    @property
    def preset(self) -> str:
        return self.mission.name

    def digest(self) -> str:
        """Return the first 16 hex digits of the SHA-256 of file and values, wherever the file lies."""
        text = json.dumps([self.sha256, dict(self.values)], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_dict(self) -> dict[str, Any]:
        return {**vars(self), "values": dict(self.values)}

    def with_values(self, values: dict[str, Any]) -> ExternalConfig:
        return external_config(self.mission, {**self.values, **values})


def external_config(mission: MissionFile, values: Mapping[str, Any]) -> ExternalConfig:
    """Return the configuration at ``values``, with defaults where they say nothing; ``UserError`` as `MissionFile.complete`."""
    return ExternalConfig(str(mission.path), mission.sha256, mission.program, mission.complete(values))


def configuration_from_dict(tree: dict[str, Any]) -> Configuration:
    """Return the inverse of ``to_dict``, for our missions and for others."""
    return ExternalConfig(**tree) if "mission_file" in tree else config_from_dict(tree)


@functools.lru_cache(maxsize=16)
def _unchanged(file: str, sha256: str, program: str) -> MissionFile:
    mission = load_mission_file(Path(file), sha256)
    if program != mission.program:
        raise UserError(
            f"the program of {file} changed while its missions ran; restore it, or resume with --accept-changes"
        )
    return mission
