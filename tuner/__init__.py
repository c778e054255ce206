"""Many missions: tune the hybrid gate with Bayesian optimisation, compare, report.

The names below are the stable ones; they are loaded when they are asked for.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.settings import CampaignSettings
    from tuner.evaluation.flying import EvaluationRun
    from tuner.jobs import evaluate, frame, reproduce, tune
    from tuner.recommendation.recommendation import Recommendation

__all__ = [
    "Campaign",
    "CampaignSettings",
    "EvaluationRun",
    "Recommendation",
    "evaluate",
    "frame",
    "reproduce",
    "tune",
]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "campaign.campaign": ["Campaign"],
        "campaign.settings": ["CampaignSettings"],
        "evaluation.flying": ["EvaluationRun"],
        "recommendation.recommendation": ["Recommendation"],
        "jobs": ["evaluate", "frame", "reproduce", "tune"],
    },
)
