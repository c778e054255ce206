"""What comes out for people: the campaign's page, comparison tables, the page of a mission.

Names are loaded when they are asked for: drawing needs matplotlib, which takes a second to load.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.report.campaign_page import write_campaign_report as write_campaign_report
    from tuner.report.mission_view import write_mission_view as write_mission_view

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "campaign_page": ["write_campaign_report"],
        "mission_view": ["write_mission_view"],
    },
)
