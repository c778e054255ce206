"""A campaign: what was asked for, its ledger of missions, beginning it, flying it, learning from earlier ones.

Names are loaded when they are asked for: a program that only names a campaign's settings need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

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
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "campaign": ["Campaign"],
        "events": ["CampaignEvent", "CampaignStatus", "CampaignSummary"],
        "settings": ["CampaignSettings"],
        "begin": ["begin_campaign"],
        "extension": ["extend_campaign"],
        "session": ["fly_campaign"],
    },
)
