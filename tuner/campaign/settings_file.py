"""A campaign's settings as YAML: the file that a user writes, and ``campaign.yaml`` in a run directory.

Both have the fields named in ``FIELDS``. In a user's file all may be left out; ``campaign.yaml`` itself will do as one.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nbv.checksums import require_checksum, with_checksum
from nbv.config import Condition, condition_from_dict, load_conditions
from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import read_yaml
from tuner.campaign.settings import CampaignSettings
from tuner.missions.external import MissionFile, load_mission_file
from tuner.missions.external.configuration import same_mission_file
from tuner.missions.registry import EXTERNAL, renamed
from tuner.problem.objective import Objective, direction_of
from tuner.problem.quality_at_cost import asked_objective
from tuner.problem.space_files import load_search_space, space_from_dict

SETTINGS_FILE = "campaign.yaml"
FORMAT_VERSION = 2  # 1: could ask for what is gone, and was proposed for by another model
FIELDS = {
    "name": "the campaign's name",
    "search_space": "a space's name, a YAML file, or the space itself",
    "rocks": "training rocks: names or mesh files",
    "budget": "missions",
    "replicates": "draws of arrival errors and noise per rock",
    "seed": "of the design and the acquisition",
    "conditions": "worlds to fly in, rock by rock: a list of names of conditions/ or YAML files, or {name: sections}",
    "mission": "a mission file, which says what is not said here; null: our own missions",
    "preset": "mission preset",
    "overrides": "parameter paths and values laid over the preset",
    "objective": "as `--objective`, or {metric, direction: maximise or minimise}",
    "second": "the same, of a second objective; null: none",
    "limit": "of the second objective, at most where less is better, at least where more is; null: the front between both",
    "risk": "as `--risk`",
    "learn_from": "as `--learn-from`; an empty list: none",
    "sampler": "as `--sampler`",
    "initial": "missions of the initial design; null: as many as suit sampler, budget and space",
    "fidelity": "photogrammetric, geometric, or module:function of your own",
    "keep": "of every mission: summary, or all (images and models)",
    "storage": "Optuna storage URL of the ledger; null: a file in the run directory",
    "in_step": "N: a proposal knows all missions but the last N - 1: the same campaign with any number of workers",
}
_TEXTS = ("name", "preset", "risk", "sampler", "fidelity", "keep", "storage")
_NUMBERS = ("budget", "replicates", "seed", "initial", "in_step")
_LISTS = ("rocks", "learn_from")
_PATHS = ("rocks", "search_space", "conditions", "learn_from", "mission")
_MAY_BE_NULL = ("initial", "in_step", "storage", "mission")


def settings_from_dict(tree: Any, source: str) -> CampaignSettings:
    """The inverse of ``CampaignSettings.to_dict``; ``source`` names the file in messages.

    Raises
    ------
    UserError
        A field that there is not, one of the wrong kind, no rocks or budget, or settings that make no campaign.
    """
    _check(tree, source)
    mission = _mission(tree.get("mission"), source)
    if mission is not None:
        tree = {**_said_by(mission), **tree}
    missing = [key for key in ("name", "search_space", "rocks", "budget") if key not in tree]
    if missing:
        raise UserError(f"{source}: {missing[0]!r} is missing: {FIELDS[missing[0]]}")
    fields: dict[str, Any] = {key: tree[key] for key in (*_TEXTS, *_NUMBERS) if key in tree}
    fields |= {key: tuple(tree[key]) for key in _LISTS if key in tree}
    space = tree["search_space"]
    if mission is None:
        fields["space"] = (
            load_search_space(space) if isinstance(space, str) else space_from_dict(space, source)
        )
    elif space == mission.space.to_dict():
        fields |= {"mission": mission, "space": mission.space}
    else:
        raise UserError(f"{source}: its search space is not that of {mission.path}; leave search_space out")
    if tree.get("conditions") is not None:
        fields["conditions"] = _conditions(tree["conditions"], source)
    if tree.get("overrides"):
        fields["overrides"] = dict(tree["overrides"])
    if isinstance(tree.get("objective"), str):
        asked = asked_objective(tree["objective"], None if mission is None else mission.directions)
        fields |= {"objective": asked.objective, "second": asked.second, "limit": asked.limit}
    elif tree.get("objective") is not None:
        fields["objective"] = _objective(tree["objective"], source, mission)
    if tree.get("second") is not None:
        fields["second"] = _objective(tree["second"], source, mission)
    if tree.get("limit") is not None:
        if isinstance(tree["limit"], bool) or not isinstance(tree["limit"], (int, float)):
            raise UserError(f"{source}: limit is {tree['limit']!r}; it must be a number: {FIELDS['limit']}")
        fields["limit"] = float(tree["limit"])
    return CampaignSettings(**fields)


def _check(tree: Any, source: str) -> None:
    if not isinstance(tree, Mapping):
        raise UserError(f"{source}: a campaign's settings map fields to values, such as `budget: 64`")
    for key, value in tree.items():
        if key not in FIELDS:
            near = difflib.get_close_matches(str(key), FIELDS, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(FIELDS)}"
            raise UserError(f"{source}: a campaign has no setting {key!r}; {hint}")
        if value is None and key in _MAY_BE_NULL:
            continue
        kinds = {**dict.fromkeys(_TEXTS, str), **dict.fromkeys(_NUMBERS, int), **dict.fromkeys(_LISTS, list)}
        if (kind := kinds.get(key)) is None:
            continue
        words = {str: "a text", int: "a whole number", list: "a list"}
        if not isinstance(value, kind) or isinstance(value, bool):
            raise UserError(f"{source}: {key} is {value!r}; it must be {words[kind]}: {FIELDS[key]}")
        if isinstance(value, list) and (other := [item for item in value if not isinstance(item, str)]):
            raise UserError(f"{source}: {key} holds {other[0]!r}; it must be a list of texts: {FIELDS[key]}")
    if not isinstance(tree.get("overrides") or {}, Mapping):
        raise UserError(
            f"{source}: overrides is {tree['overrides']!r}; it must map parameter paths to values"
        )


def _mission(tree: Any, source: str) -> MissionFile | None:
    if tree is None:
        return None
    if isinstance(tree, str):
        return load_mission_file(Path(tree))
    if not isinstance(tree, Mapping) or set(tree) != {"file", "sha256"}:
        raise UserError(f"{source}: mission is {tree!r}; it must be the path of a mission file")
    return same_mission_file(Path(str(tree["file"])), str(tree["sha256"]))


def with_mission_file(stored: Mapping[str, Any], file: Path, directory: Path) -> dict[str, Any]:
    """The settings of the campaign in ``directory`` with its mission file where the user says that it is.

    Raises
    ------
    UserError
        It is no mission file, or not the one that the campaign began with.
    """
    mission, began = load_mission_file(file), stored.get("mission")
    if not isinstance(began, Mapping):
        raise UserError(f"the campaign in {directory} is of our own missions; leave --mission out")
    if mission.sha256 != began.get("sha256"):
        raise UserError(f"{mission.path} is not the mission file that the campaign in {directory} began with")
    return {**stored, "mission": {"file": str(mission.path), "sha256": mission.sha256}}


def _said_by(mission: MissionFile) -> dict[str, Any]:
    """The fields that a mission file decides."""
    return {
        "search_space": mission.space.to_dict(),
        "rocks": [instance.name for instance in mission.instances],
        "replicates": mission.replicates,
        "objective": {"metric": mission.objective.metric, "direction": mission.objective.direction},
        "fidelity": EXTERNAL,
    }


def _conditions(tree: Any, source: str) -> tuple[Condition, ...]:
    if isinstance(tree, Mapping):
        return tuple(condition_from_dict(str(name), content, source) for name, content in tree.items())
    if not isinstance(tree, list) or any(not isinstance(name, str) for name in tree):
        raise UserError(f"{source}: conditions is {tree!r}; it must be {FIELDS['conditions']}")
    return load_conditions(tree)


def _objective(tree: Any, source: str, mission: MissionFile | None) -> Objective:
    if isinstance(tree, str):
        if mission is not None:
            return asked_objective(tree, mission.directions).objective
        return Objective(tree, direction_of(tree))
    if not isinstance(tree, Mapping) or "metric" not in tree or not set(tree) <= {"metric", "direction"}:
        raise UserError(f"{source}: an objective is a metric's path or {{metric, direction}}, not {tree!r}")
    metric = str(tree["metric"])
    return Objective(metric, tree.get("direction") or direction_of(metric))


def read_settings_file(path: Path) -> dict[str, Any]:
    """The fields in a user's file, whose relative paths are taken from its folder, or in a ``campaign.yaml``.

    Raises
    ------
    UserError
        The file cannot be read, is no YAML, or has a field that there is not.
    """
    tree = read_yaml(path)
    if isinstance(tree, Mapping) and "format" in tree:
        _check_format(tree, path)
        fields = renamed(tree.get("settings") or {})
        _check(fields, str(path))
        return fields
    fields = renamed(tree or {}) if isinstance(tree or {}, Mapping) else tree
    _check(fields, str(path))
    return _from_folder(fields, path.parent)


def _from_folder(fields: dict[str, Any], folder: Path) -> dict[str, Any]:
    """``fields`` with paths as they are from here; what has neither a slash nor a suffix is a name."""

    def placed(text: Any) -> Any:
        is_path = isinstance(text, str) and (os.sep in text or Path(text).suffix) and not text.startswith("~")
        return str(folder / text) if is_path else text

    for key in _PATHS:
        value = fields.get(key)
        if value is not None:
            fields[key] = [placed(item) for item in value] if isinstance(value, list) else placed(value)
    return fields


def read_settings(directory: Path) -> tuple[dict[str, Any], str, str]:
    """``(settings, identity, digest of the base configuration)`` of the campaign in ``directory``.

    Raises
    ------
    UserError
        There is none, or one of another version.
    """
    path = directory / SETTINGS_FILE
    if not path.is_file():
        raise UserError(
            f"{directory} holds no campaign ({SETTINGS_FILE} is missing); name a campaign's directory"
        )
    try:
        tree = read_yaml(path)
        if not isinstance(tree, Mapping):
            raise UserError(f"{path} is empty or no campaign's settings; restore the file")
        _check_format(tree, path)
        require_checksum(tree, str(path))
        return renamed(tree["settings"]), tree["id"], tree["base_config_digest"]
    except (KeyError, TypeError) as error:
        raise UserError(f"{path} is not a campaign's settings ({error!r}); restore the file") from error


def write_settings(directory: Path, tree: Mapping[str, Any]) -> None:
    """``campaign.yaml`` with a checksum; ``OSError`` where it cannot be written."""
    write_atomic(directory / SETTINGS_FILE, settings_text(tree))


def without_storage(tree: Mapping[str, Any]) -> dict[str, Any]:
    """``tree`` as a ledger keeps it: whoever goes on with the campaign says where that ledger is."""
    return {**tree, "settings": {**tree["settings"], "storage": None}}


def settings_text(tree: Mapping[str, Any]) -> str:
    """What ``campaign.yaml`` holds."""
    return yaml.safe_dump(with_checksum(tree), sort_keys=False, allow_unicode=True)


def _check_format(tree: Mapping[str, Any], path: Path) -> None:
    if tree["format"] != FORMAT_VERSION:
        raise UserError(
            f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; open the campaign with the "
            "version that began it"
        )


def first_difference(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In which field two campaigns differ, in words; empty if in none."""
    for key in wanted:
        if stored.get(key) != wanted[key]:
            if key == "search_space":
                return f"search space {stored[key].get('name')!r} differs from {wanted[key].get('name')!r}"
            return f"{key} is {stored.get(key)!r} there, not {wanted[key]!r}"
    return ""
