"""The beginning of a campaign, whose ledger and ``campaign.yaml`` are written, and its extension by a larger budget."""

from __future__ import annotations

import dataclasses
import datetime
import shlex
import uuid
from pathlib import Path

from nbv.errors import UserError
from nbv.safe_files import read_yaml, write_atomic
from tuner.campaign.campaign import LEARNED_FILE, Campaign
from tuner.campaign.earlier_campaigns import learn_from
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import (
    FORMAT_VERSION,
    SETTINGS_FILE,
    read_settings,
    write_settings,
)
from tuner.missions.long_runs import exclusive
from tuner.samplers.registry import make_sampler


def begin_campaign(directory: Path, settings: CampaignSettings) -> Campaign:
    """Begin a campaign in a new or empty directory.

    Raises `UserError`: the directory holds something already or cannot be written; there is nothing to learn from
    where ``settings`` says so.
    """
    from tuner.campaign.ledger import Ledger  # noqa: PLC0415  loads Optuna

    if (directory / SETTINGS_FILE).exists():
        theirs = read_settings(directory)[0]
        what = "this campaign" if theirs == settings.to_dict() else f"another campaign ({theirs['name']!r})"
        raise UserError(
            f"{directory} already holds {what}; resume it with `gatetune campaign resume {shlex.quote(str(directory))}` "
            "or choose another directory"
        )
    if directory.exists() and (not directory.is_dir() or not all(map(_is_leftover, directory.iterdir()))):
        raise UserError(f"{directory} exists and is not an empty directory; choose another directory")
    learned = None
    if settings.learn_from:
        learned = learn_from(settings.learn_from, settings.problem, settings.objective)
    make_sampler(settings.sampler, settings.search)  # refuses a search space that it cannot handle
    identity = uuid.uuid4().hex
    try:
        directory.mkdir(parents=True, exist_ok=True)
        tree = {
            "format": FORMAT_VERSION,
            "id": identity,
            "created": _now(),
            "base_config_digest": settings.problem.base.digest(),
            "settings": settings.to_dict(),
        }
        if learned is not None:
            write_atomic(directory / LEARNED_FILE, learned.to_json())
        write_settings(directory, tree)
        # Ended between the two, it is a campaign without missions, which a resume goes on with.
        ledger = Ledger(directory, settings.name, settings.problem, settings.goal, identity)
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another directory") from error
    return Campaign(directory, settings, ledger)


def extend_campaign(campaign: Campaign, budget: int) -> Campaign:
    """Return the campaign with a larger budget: so many missions in all.

    The initial design and every proposal so far are those of the smaller budget; the sampler goes on from there.
    ``campaign.yaml`` holds the new budget and, under ``extensions``, when it grew from what.

    Raises `UserError`: the budget is not larger; ``campaign.yaml`` cannot be written.
    """
    old, directory = campaign.settings, campaign.directory
    if budget <= old.budget:
        raise UserError(
            f"the campaign in {directory} has a budget of {old.budget} missions; {budget} does not extend it, "
            "give more"
        )
    # The first session decided the size of the initial design: keep it.
    settings = dataclasses.replace(old, budget=budget, initial=old.initial_size())
    path = directory / SETTINGS_FILE
    try:
        with exclusive(directory):
            tree = read_yaml(path)
            tree["settings"] = settings.to_dict()
            tree.setdefault("extensions", []).append({"when": _now(), "from": old.budget, "to": budget})
            write_settings(directory, tree)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; make room, then resume") from error
    return Campaign(directory, settings, campaign.ledger)


def _is_leftover(path: Path) -> bool:
    """Return whether a campaign that was killed before it had its ``campaign.yaml`` left this file."""
    temporary = path.name.startswith(".") and path.name.endswith(".tmp")
    return path.name == LEARNED_FILE or (
        temporary and any(f in path.name for f in (LEARNED_FILE, SETTINGS_FILE))
    )


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")
