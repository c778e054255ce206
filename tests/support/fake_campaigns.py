"""Campaigns of fake missions: settings that each test changes where it cares, and a flight to the end."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import synthetic
from in_process import InProcessExecutor

from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign, CampaignEvent
from tuner.campaign.session import run_campaign
from tuner.campaign.settings import CampaignSettings

FIDELITY = "fake"


def settings(**changes: object) -> CampaignSettings:
    """Two rocks, two parameters, nine missions of sampler gp, and ``changes``."""
    fields: dict[str, object] = {
        "name": "test",
        "space": synthetic.SPACE,
        "rocks": ("a", "b"),
        "budget": 9,
        "replicates": 1,
        "learn_from": (),
        "seed": 1,
        "sampler": "gp",
        "fidelity": FIDELITY,
    }
    return CampaignSettings(**{**fields, **changes})


def stop_after(missions: int) -> Callable[[CampaignEvent], None]:
    """A listener that ends a campaign after so many missions, as Ctrl-C does."""

    def stop(event: CampaignEvent) -> None:
        if event.kind == "finished" and event.finished == missions:
            os.kill(os.getpid(), signal.SIGINT)

    return stop


def run(directory: Path, **changes: object) -> Campaign:
    """A finished campaign of ``settings(**changes)``."""
    campaign = begin_campaign(directory, settings(**changes))
    run_campaign(campaign, InProcessExecutor())
    return campaign
