"""A campaign's settings as YAML: the file that a user writes, what the command line adds, ``campaign.yaml`` in a run directory.

All have the fields of `CampaignSettings`. In a user's file all may be left out; ``campaign.yaml`` itself will do as one.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nbv.config.declaration import declared, leaves
from nbv.dense import with_best_dense_stage
from nbv.errors import UserError
from nbv.evaluation.registry import PREDICTED, all_metrics
from nbv.safe_files import read_yaml, to_yaml, write_atomic
from tuner.campaign.mission_problem import absolute_rocks, rock_arguments
from tuner.campaign.settings import CampaignSettings
from tuner.missions.registry import DEFAULT_FIDELITY, kind_on, mission_kind, usual_preset
from tuner.problem.goal import parse_goal

SETTINGS_FILE = "campaign.yaml"
FORMAT_VERSION = 5
SETTINGS = declared(CampaignSettings)
# `make tune`: the gate, then the planner, with 20 photographs in a dim hall, on rocks and on shapes with pockets: on what is nearly
# convex an orbit is as good as any plan.
QUICK: dict[str, Any] = {
    "rocks": ["slab", "part-1", "vesicular", "lever-0", "cavern", "figure-0"],
    "replicates": 1,
    "conditions": ["indoors"],
    "preset": "campaign-reduced",
    "overrides": {
        "photographs": 20,
        "seeds": 12,
        "sparse.ground_features": 2000,
        "dense.agreeing_views": 3,
    },
    "space": "plan_and_gate",
    "compare_on": ["arch", "part-20000", "fin", "lever-20000", "figure-20000"],
}


def settings_from_dict(tree: Any, source: str) -> CampaignSettings:
    """Return the inverse of ``CampaignSettings.to_dict``; ``source`` names the file in messages.

    Raises `UserError`: a setting that there is not, one of the wrong kind, or settings that make no campaign.
    """
    full = _checked(tree, source)
    for key in ("second", "objective"):
        if isinstance(full.get(key), str):  # ``f_score@photographs<=21`` stands for three settings
            goal = parse_goal(full[key])
            full[key] = SETTINGS[key].to_yaml(goal.objective)
            if goal.second is not None:
                full |= {"second": SETTINGS["second"].to_yaml(goal.second), "limit": goal.limit}
    # Null is as if it were left out.
    given = {name: SETTINGS[name].from_yaml(raw, source) for name, raw in full.items() if raw is not None}
    return CampaignSettings(**given)


def _checked(tree: Any, source: str) -> dict[str, Any]:
    """Return ``tree`` as a dictionary; raise `UserError` for an unknown setting."""
    try:
        values = leaves(SETTINGS, tree, "setting")
    except UserError as error:
        raise UserError(f"{source}: {error}") from None
    for name, raw in values.items():
        if raw is not None and SETTINGS[name].read is None:
            SETTINGS[name].from_yaml(raw, source)
    return values


def read_settings_file(path: Path) -> dict[str, Any]:
    """Return the settings in a user's file, whose relative paths are taken from its folder, or in a ``campaign.yaml``.

    Raises `UserError`: the file cannot be read, is no YAML, or has a setting that there is not.
    """
    tree = read_yaml(path)
    if isinstance(tree, Mapping) and "format" in tree:
        _check_format(tree, path)
        return _checked(tree.get("settings") or {}, str(path))
    fields = _checked(tree or {}, str(path))

    def placed(text: Any) -> Any:  # what has neither a slash nor a suffix is a name
        is_path = isinstance(text, str) and (os.sep in text or Path(text).suffix) and not text.startswith("~")
        return str(path.parent / text) if is_path else text

    for key, value in fields.items():
        if value is not None and SETTINGS[key].has_paths:
            fields[key] = [placed(item) for item in value] if isinstance(value, list) else placed(value)
    return fields


def read_settings(directory: Path) -> tuple[dict[str, Any], str, str]:
    """Return ``(settings, identity, digest of the base configuration)`` of the campaign in ``directory``.

    Raises `UserError`: there is none, or one of another version.
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
        return _checked(tree["settings"], str(path)), tree["id"], tree["base_config_digest"]
    except (KeyError, TypeError) as error:
        raise UserError(f"{path} is not a campaign's settings ({error!r}); restore the file") from error


def write_settings(directory: Path, tree: Mapping[str, Any]) -> None:
    """Write ``campaign.yaml``; ``OSError`` where it cannot be written."""
    write_atomic(directory / SETTINGS_FILE, to_yaml(dict(tree), allow_unicode=True))


def _check_format(tree: Mapping[str, Any], path: Path) -> None:
    if tree["format"] != FORMAT_VERSION:
        raise UserError(
            f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; open the campaign with "
            "the version that began it"
        )


def first_difference(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return in words in which field two campaigns differ; empty if in none."""
    for key in wanted:
        if stored.get(key) != wanted[key]:
            if key == "space":
                return f"search space {stored[key].get('name')!r} differs from {wanted[key].get('name')!r}"
            return f"{key} is {stored.get(key)!r} there, not {wanted[key]!r}"
    return ""


def laid_over(*layers: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of ``layers``, the last of which counts; null counts as left out.

    A constraint belongs to its objective: one that comes with another objective takes its place, or there is none.
    """
    tree = dict[str, Any]()
    for layer in layers:
        given = {key: value for key, value in layer.items() if value is not None}
        if "objective" in given:
            tree = {key: value for key, value in tree.items() if key not in ("second", "limit")}
        tree |= given
    return tree


def merged_settings(file: Path | None, given: Mapping[str, Any], *, quick: bool) -> dict[str, Any]:
    """Return the YAML form of what is asked for: what was ``given`` goes before the file, the file before ``quick``.

    Overrides are laid over one another.

    Raises `UserError`: as `read_settings_file`.
    """
    read = read_settings_file(file) if file else {}
    layers = (QUICK if quick else {}, read, given)
    tree = laid_over(*layers)
    if quick and not laid_over(read, given).get("preset"):
        # Photographs that were taken have a preset of their own.
        usual = usual_preset(tree["rocks"], tree.get("fidelity") or DEFAULT_FIDELITY)
        tree["preset"] = usual if usual == "photographs" else QUICK["preset"]
    overrides = {path: value for layer in layers for path, value in (layer.get("overrides") or {}).items()}
    return {"name": SETTINGS["name"].default, **tree, "overrides": overrides}


def settings_there(directory: Path, given: Mapping[str, Any]) -> CampaignSettings | None:
    """Return the settings of the campaign in ``directory`` under those ``given``, which it must have; None where none is.

    Overrides are laid over one another; what was decided on another machine stays.

    Raises `UserError`: as `read_settings` and `settings_from_dict`.
    """
    if not given:
        return None
    stored = read_settings(directory)[0]
    overrides = {**(stored.get("overrides") or {}), **(given.get("overrides") or {})}
    tree = {**laid_over(stored, given), "overrides": overrides}
    return settings_from_dict(_with_absolute_rocks(_checked(tree, "settings given")), "settings given")


def _with_absolute_rocks(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``tree`` with mesh files as absolute paths."""
    placed = {key: absolute_rocks(rocks) for key in ("rocks", "compare_on") if (rocks := tree.get(key))}
    return {**tree, **placed}


def resolved_settings(tree: Mapping[str, Any], source: str) -> CampaignSettings:
    """Return the settings that a YAML form means on this machine; ``source`` names a file in messages.

    Raises `UserError`: as `settings_from_dict`; a rock that cannot be loaded or is held out.
    """
    tree = _with_absolute_rocks(_checked(tree, source))
    fidelity = tree.get("fidelity") or DEFAULT_FIDELITY
    if fidelity == DEFAULT_FIDELITY:
        tree["overrides"] = with_best_dense_stage(tree.get("overrides") or {})
    if tree.get("rocks") and not tree.get("preset"):
        tree["preset"] = usual_preset(tree["rocks"], fidelity)
    settings = settings_from_dict(tree, source)
    _require_metrics(settings)
    rock_arguments(settings.rocks, tuned=True)
    rock_arguments(settings.compare_on)
    problem = settings.problem
    for place in problem.instances:  # a set of photographs is under no condition, and other kinds fly no set
        config = problem.config(problem.default, place.condition)
        kind_on(place.rock, settings.fidelity).require_possible(config)
    return settings


def _require_metrics(settings: CampaignSettings) -> None:
    """Raise `UserError` where missions have no such metric: better now than after eight of them."""
    kind = mission_kind(settings.fidelity)
    if not (kind.truth or kind.predicts):
        return
    thresholds = settings.problem.base.evaluation.thresholds_mm
    measured = PREDICTED if kind.predicts else all_metrics()
    keys = {key.replace("{t}", f"{t:g}") for key in measured for t in thresholds}
    for objective in settings.goal.objectives:
        *surface, key = objective.metric.split(".")
        if surface[:1] == ["registered"]:
            surface = surface[1:]
        unknown = surface in (["whole"], ["observable"]) and key not in keys
        if unknown or (not surface and key in keys):
            near = difflib.get_close_matches(key, keys, 1)
            hint = f"did you mean {(surface or ['observable'])[0]}.{near[0]}? " if near else ""
            raise UserError(
                f"a {settings.fidelity} mission has no metric {objective.metric!r}; {hint}docs/reference/metrics.md names them"
            )
