"""The page of a campaign: facts, figures, rows, provenance.

Loaded when it is asked for: the missions beside it are shown without what draws it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.report.campaign.page import write_campaign_report

__all__ = ["write_campaign_report"]
__getattr__, __dir__, _ = lazy_loader.attach(__name__, submod_attrs={"page": ["write_campaign_report"]})
