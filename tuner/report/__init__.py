"""What comes out for people: the campaign's page, comparison tables, mission figures.

Names are loaded when they are asked for: drawing needs matplotlib, which takes a second to load.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.report.campaign_report import write_campaign_report
    from tuner.report.comparison_report import write_comparison_report
    from tuner.report.mission_figures import write_mission_figures

__all__ = ["write_campaign_report", "write_comparison_report", "write_mission_figures"]
_FILES = {
    "write_campaign_report": "campaign_report",
    "write_comparison_report": "comparison_report",
    "write_mission_figures": "mission_figures",
}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
