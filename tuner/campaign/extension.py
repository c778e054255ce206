"""A larger budget for a campaign that has begun: what it has flown stays."""

from __future__ import annotations

import dataclasses
import datetime
from pathlib import Path

from nbv.errors import UserError
from nbv.safe_files import read_yaml
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE, write_settings
from tuner.missions.long_runs import exclusive


def extend_campaign(
    directory: Path, budget: int, fidelity: str | None = None, mission: Path | None = None
) -> Campaign:
    """Give the campaign in ``directory`` a larger budget.

    The initial design and every proposal so far are those of the smaller budget; the sampler goes on from there.
    ``campaign.yaml`` holds the new budget and, under ``extensions``, when it grew from what.

    Parameters
    ----------
    directory
        The campaign's run directory.
    budget
        Missions in all, more than before.
    fidelity, mission
        What the caller allows the campaign to run, as in ``Campaign.open``.

    Raises
    ------
    UserError
        As ``Campaign.open``; the budget is not larger.
    """
    campaign = Campaign.open(directory, fidelity=fidelity, mission=mission)
    old = campaign.settings
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
            when = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
            tree.setdefault("extensions", []).append({"when": when, "from": old.budget, "to": budget})
            write_settings(directory, tree)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; make room, then resume") from error
    return Campaign.open(directory, fidelity=fidelity, mission=mission)
