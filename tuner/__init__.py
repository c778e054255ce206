"""Many missions: tune the hybrid gate with Bayesian optimisation, compare, report.

The names below are the stable ones; they are loaded when they are asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

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
_FILES = {
    "Campaign": "campaign.campaign",
    "CampaignSettings": "campaign.settings",
    "EvaluationRun": "evaluation.flying",
    "Recommendation": "recommendation.recommendation",
    "evaluate": "jobs",
    "frame": "jobs",
    "reproduce": "jobs",
    "tune": "jobs",
}


def __getattr__(name: str) -> Any:
    # A room is loaded by the import of it; `tuner.evaluation` stays the room.
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
