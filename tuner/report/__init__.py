"""What comes out for people: the campaign's page, comparison tables, mission figures.

Names are loaded when they are asked for: drawing needs matplotlib, which takes a second to load.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.report.campaign.page import write_campaign_report
    from tuner.report.comparison.page import write_comparison_report
    from tuner.report.mission.figures import write_mission_figures
    from tuner.report.mission.recording import write_mission_recording
    from tuner.report.mission.walk import write_mission_view

__all__ = [
    "write_campaign_report",
    "write_comparison_report",
    "write_mission_figures",
    "write_mission_recording",
    "write_mission_view",
]
_FILES = {
    "write_campaign_report": "campaign.page",
    "write_comparison_report": "comparison.page",
    "write_mission_figures": "mission.figures",
    "write_mission_recording": "mission.recording",
    "write_mission_view": "mission.walk",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
