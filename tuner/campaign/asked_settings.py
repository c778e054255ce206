"""From the command line and a settings file to a campaign's settings."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, TypedDict

from nbv.dense import best_dense_stage
from nbv.errors import UserError
from nbv.evaluation.registry import METRICS
from nbv.mission.function import Keep
from tuner.campaign.rock_choice import (
    QUICK_ROCKS,
    Making,
    refuse_held_out,
    rock_arguments,
    training_rocks,
)
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import read_settings_file, settings_from_dict
from tuner.campaign.shipped import NOTHING, sources_by_default
from tuner.missions.external import load_mission_file
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.options import Risk
from tuner.problem.search_space import ours


class CampaignFields(TypedDict, total=False):
    """What a campaign is, as its settings file says it (docs/reference/campaign_settings.md)."""

    name: str
    search_space: str | Mapping[str, Any]
    rocks: Sequence[str]
    budget: int
    replicates: int
    seed: int
    conditions: Sequence[str] | Mapping[str, Any]
    mission: str | None
    preset: str
    overrides: Mapping[str, Any]
    objective: str | Mapping[str, str]
    second: str | Mapping[str, str] | None
    limit: float | None
    risk: Risk
    learn_from: Sequence[str]
    sampler: str
    initial: int | None
    fidelity: str
    keep: Keep
    storage: str | None
    in_step: int | None


DEFAULTS: dict[str, Any] = {
    "name": "campaign",
    "search_space": "gate_weights_and_pool",  # gains on other rocks, the paper's own space hardly (docs/results/paper_space.md)
    "budget": 64,
    "replicates": 2,
}
_OURS = {"space": "search_space", "condition": "conditions", "preset": "preset", "fidelity": "fidelity"}
# `make tune`: the space where there is most to gain, for the quality that the paper's 24 + 8 have on these rocks.
QUICK: dict[str, Any] = {
    "budget": 36,
    "rocks": QUICK_ROCKS,
    "search_space": "photographs",
    "objective": "photographs@f_score>=98",
    "overrides": {"dense.agreeing_views": 3},
}


def asked_fields(
    file: Path | None, given: Mapping[str, Any], overrides: Mapping[str, Any], *, quick: bool
) -> dict[str, Any]:
    """Fields as in a settings file: what was ``given`` goes before the file, the file before the defaults.

    ``overrides`` are laid over the file's. Raises ``UserError`` as `read_settings_file`, and for options of our own missions
    beside a mission file, which must have been given: a settings file may not choose what is run.
    """
    read = read_settings_file(file) if file else {}
    if given.get("mission") is None and read.get("mission") is not None:
        named = read["mission"]["file"] if isinstance(read["mission"], dict) else read["mission"]
        raise UserError(
            f"{file} asks to run a mission of its own; if you trust it, name it: --mission {named}"
        )
    if given.get("mission") is not None:
        options = {f"--{key}": given[field] for key, field in _OURS.items()}
        for option, value in {**options, "--set": overrides or None, "--quick": quick or None}.items():
            if value is not None:
                raise UserError(f"{option} is of our own missions; with --mission leave it out")
        mission = load_mission_file(Path(given["mission"]))
        fields = {"name": mission.name, "budget": DEFAULTS["budget"], **read}
        return fields | {key: value for key, value in given.items() if value is not None}
    fields = {**DEFAULTS, **(QUICK if quick else {}), **read}
    fields |= {key: value for key, value in given.items() if value is not None}
    return {**fields, "overrides": {**(fields.get("overrides") or {}), **overrides}}


def asked_settings(fields: Mapping[str, Any], source: str, making: Making = nullcontext) -> CampaignSettings:
    """The settings that ``fields`` mean, rocks looked up; ``source`` names a file in messages.

    Raises
    ------
    UserError
        As `settings_from_dict`; a rock that cannot be loaded or is held out.
    """
    sources = fields.get("learn_from")
    if fields.get("mission") is not None:
        return settings_from_dict({**fields, "learn_from": _sources(sources or [])}, source)
    if fields.get("fidelity", DEFAULT_FIDELITY) == DEFAULT_FIDELITY:
        fields = {**fields, "overrides": best_dense_stage(fields.get("overrides") or {})}
    rocks = fields.get("rocks") or training_rocks()
    first = settings_from_dict({**fields, "rocks": rocks, "learn_from": _sources(sources or [])}, source)
    _require_metrics(first)
    chosen = rock_arguments(first.rocks, making)
    refuse_held_out(chosen)
    if sources is None:
        learned = sources_by_default(first.space, first.objective, first.sampler, first.second)
        return dataclasses.replace(first, rocks=tuple(chosen), learn_from=learned)
    return dataclasses.replace(first, rocks=tuple(chosen))


def _require_metrics(settings: CampaignSettings) -> None:
    """`UserError` where our missions have no such metric: better now than after eight of them."""
    if settings.fidelity not in ("photogrammetric", "geometric"):
        return
    thresholds = ours(settings.base_config()).evaluation.thresholds_mm
    keys = {key.replace("{t}", f"{t:g}") for key in METRICS for t in thresholds}
    for objective in filter(None, (settings.objective, settings.second)):
        *surface, key = objective.metric.split(".")
        if surface[:1] == ["registered"]:
            surface = surface[1:]
        if surface in (["whole"], ["observable"]) and key not in keys:
            near = difflib.get_close_matches(key, keys, 1)
            hint = f"did you mean {surface[0]}.{near[0]}? " if near else ""
            raise UserError(
                f"a mission has no metric {objective.metric!r}; {hint}docs/reference/metrics.md names them"
            )


def _sources(given: Sequence[str]) -> Sequence[str]:
    if NOTHING in given and len(given) > 1:
        raise UserError(f"--learn-from {NOTHING} stands beside another --learn-from; leave one of them out")
    return [] if NOTHING in given else given
