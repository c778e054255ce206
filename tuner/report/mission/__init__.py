"""The figures of one mission, and why a candidate won.

Names are loaded when they are asked for: a page to walk around in needs nothing that draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.report.mission.explain import explain_state
    from tuner.report.mission.figures import write_mission_figures

__all__ = ["explain_state", "write_mission_figures"]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"explain": ["explain_state"], "figures": ["write_mission_figures"]}
)
