"""Which configuration to use, and which may be recommended at all.

Names are loaded when they are asked for: what only names a setting need not wait for torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.recommendation.choose import recommend
    from tuner.recommendation.eligible import may_be_recommended
    from tuner.recommendation.next_rock import next_rock
    from tuner.recommendation.recommendation import Limit, NextRock, Recommendation, RunnerUp

__all__ = ["Limit", "NextRock", "Recommendation", "RunnerUp", "may_be_recommended", "next_rock", "recommend"]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "choose": ["recommend"],
        "next_rock": ["next_rock"],
        "recommendation": ["Limit", "NextRock", "Recommendation", "RunnerUp"],
        "eligible": ["may_be_recommended"],
    },
)
