"""From the command line and a settings file to a campaign's settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import read_settings_file, settings_from_dict
from tuner.commands.console import best_dense_stage, rock_arguments
from tuner.commands.rock_choice import QUICK_ROCKS, refuse_held_out, training_rocks
from tuner.missions.registry import DEFAULT_RUNNER

DEFAULTS: dict[str, Any] = {
    "name": "campaign",
    "search_space": "gate_and_weights",
    "budget": 64,
    "replicates": 2,
}
# `make tune`: what a real campaign needs, small enough for a quarter of an hour on two cores.
QUICK: dict[str, Any] = {"budget": 48, "rocks": QUICK_ROCKS}


def asked_fields(
    file: Path | None, given: Mapping[str, Any], overrides: Mapping[str, Any], *, quick: bool
) -> dict[str, Any]:
    """Fields as in a settings file: what was ``given`` goes before the file, the file before the defaults.

    ``overrides`` are laid over the file's. Raises ``UserError`` as `read_settings_file`.
    """
    fields = {**DEFAULTS, **(QUICK if quick else {}), **(read_settings_file(file) if file else {})}
    fields |= {key: value for key, value in given.items() if value is not None}
    return {**fields, "overrides": {**(fields.get("overrides") or {}), **overrides}}


def asked_settings(fields: Mapping[str, Any], source: str) -> CampaignSettings:
    """The settings that ``fields`` mean, rocks looked up; ``source`` names a file in messages.

    Raises
    ------
    UserError
        As `settings_from_dict`; a rock that cannot be loaded or is held out.
    """
    from tuner.campaign.shipped import sources_by_default  # with what follows it takes seconds to load

    if fields.get("runner", DEFAULT_RUNNER) == DEFAULT_RUNNER:
        fields = {**fields, "overrides": best_dense_stage(fields.get("overrides") or {})}
    sources = fields.get("learn_from")
    rocks = fields.get("rocks") or training_rocks()
    first = settings_from_dict(
        {**fields, "rocks": list(rocks), "learn_from": _sources(sources or ())}, source
    )
    chosen = rock_arguments(list(first.rocks))
    refuse_held_out(chosen)
    if sources is None:
        learned = sources_by_default(first.space, first.objective, first.sampler, first.second)
        return dataclasses.replace(first, rocks=tuple(chosen), learn_from=learned)
    return dataclasses.replace(first, rocks=tuple(chosen))


def _sources(given: Sequence[str]) -> list[str]:
    from tuner.campaign.shipped import NOTHING

    if NOTHING in given and len(given) > 1:
        raise UserError(f"--learn-from {NOTHING} stands beside another --learn-from; leave one of them out")
    return [] if NOTHING in given else list(given)
