"""From a settings file and the command line to a campaign's settings."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from nbv.dense import best_dense_stage
from nbv.errors import UserError
from nbv.evaluation.registry import METRICS, PREDICTED
from tuner.campaign.rock_choice import QUICK_ROCKS, Making, absolute_rocks, refuse_held_out, rock_arguments
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import SETTINGS, read_settings_file, settings_from_dict
from tuner.missions.external import load_mission_file
from tuner.missions.registry import DEFAULT_FIDELITY, is_geometric
from tuner.problem.drawn_rocks import with_families
from tuner.problem.objective import reached
from tuner.problem.search_space import ours

# `make tune`: the space where there is most to gain, for the quality that the paper's 24 + 8 have on these rocks.
QUICK: dict[str, Any] = {
    "budget": 36,
    "rocks": QUICK_ROCKS,
    "space": "photographs",
    "objective": "photographs@f_score>=98",
    "overrides": {"dense.agreeing_views": 3},
}


def asked_fields(file: Path | None, given: Mapping[str, Any], *, quick: bool) -> dict[str, Any]:
    """Return the YAML form of what is asked for: what was ``given`` goes before the file, the file before ``quick``.

    Overrides are laid over one another.

    Raises
    ------
    UserError
        As `read_settings_file`; a setting of our own missions beside a mission file; a mission file that was not
        ``given``: a settings file may not choose what is run.
    """
    read = read_settings_file(file) if file else {}
    layers = (QUICK if quick else {}, read, given)
    tree = {key: value for layer in layers for key, value in layer.items() if value is not None}
    if "mission" in given:
        wrong = [s.option for name, s in SETTINGS.items() if s.ours and name in given]
        if wrong or quick:
            raise UserError(f"{[*wrong, '--quick'][0]} is of our own missions; with --mission leave it out")
        return {"name": load_mission_file(Path(given["mission"])).name, **tree}
    if "mission" in tree:
        named = tree["mission"]["file"] if isinstance(tree["mission"], dict) else tree["mission"]
        raise UserError(
            f"{file} asks to run a mission of its own; if you trust it, name it: --mission {named}"
        )
    overrides = {path: value for layer in layers for path, value in (layer.get("overrides") or {}).items()}
    return {"name": SETTINGS["name"].default, **tree, "overrides": overrides}


def asked_settings(tree: Mapping[str, Any], source: str, making: Making = nullcontext) -> CampaignSettings:
    """Return the settings that a YAML form means on this machine; ``source`` names a file in messages.

    Raises
    ------
    UserError
        As `settings_from_dict`; a rock that cannot be loaded or is held out.
    """
    if tree.get("mission") is not None:
        return settings_from_dict(tree, source)
    tree = dict(tree)
    if tree.get("fidelity", DEFAULT_FIDELITY) == DEFAULT_FIDELITY:
        tree["overrides"] = best_dense_stage(tree.get("overrides") or {})
    if isinstance(tree.get("rocks"), (list, tuple)):
        tree["rocks"] = absolute_rocks(with_families(tree["rocks"]))
    settings = settings_from_dict(tree, source)
    _require_metrics(settings)
    rock_arguments(settings.rocks, making)
    refuse_held_out(settings.rocks)
    return settings


def _require_metrics(settings: CampaignSettings) -> None:
    """Raise `UserError` where our missions have no such metric: better now than after eight of them."""
    if settings.fidelity not in ("photogrammetric", "geometric"):
        return
    thresholds = ours(settings.base_config()).evaluation.thresholds_mm
    measured = PREDICTED if is_geometric(settings.fidelity) else METRICS
    keys = {key.replace("{t}", f"{t:g}") for key in measured for t in thresholds}
    for objective in filter(None, (settings.objective, settings.second)):
        share = reached(objective.metric)
        *surface, key = (share[0] if share else objective.metric).split(".")
        if surface[:1] == ["registered"]:
            surface = surface[1:]
        unknown = surface in (["whole"], ["observable"]) and key not in keys
        if unknown or (not surface and key in keys):
            near = difflib.get_close_matches(key, keys, 1)
            hint = f"did you mean {(surface or ['observable'])[0]}.{near[0]}? " if near else ""
            raise UserError(
                f"a {settings.fidelity} mission has no metric {objective.metric!r}; {hint}docs/reference/metrics.md names them"
            )
