"""A campaign: what was asked for, its ledger of missions, beginning it, flying it, learning from earlier ones.

Names are loaded when they are asked for: a program that only names a campaign's settings need not wait for torch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.campaign.begin import begin_campaign
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.events import CampaignEvent, CampaignStatus, CampaignSummary
    from tuner.campaign.extension import extend_campaign
    from tuner.campaign.session import fly_campaign
    from tuner.campaign.settings import CampaignSettings

__all__ = [
    "Campaign",
    "CampaignEvent",
    "CampaignSettings",
    "CampaignStatus",
    "CampaignSummary",
    "begin_campaign",
    "extend_campaign",
    "fly_campaign",
]
_FILES = {
    "Campaign": "campaign",
    "CampaignEvent": "events",
    "CampaignSettings": "settings",
    "CampaignStatus": "events",
    "CampaignSummary": "events",
    "begin_campaign": "begin",
    "extend_campaign": "extension",
    "fly_campaign": "session",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
