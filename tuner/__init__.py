"""Many missions: tune the hybrid gate with Bayesian optimisation, compare, report.

The names below are the stable ones; they are loaded when they are asked for.
"""

import signal
import sys

# The command, or `python -m tuner.cli`: Ctrl-C while it loads ends it without a traceback.
_is_command = sys.argv[0] == "-m" or sys.argv[0].endswith("/gatetune")
if _is_command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from typing import TYPE_CHECKING  # noqa: E402

import lazy_loader  # noqa: E402

if TYPE_CHECKING:
    from tuner.answer.answer import answer_of as answer_of
    from tuner.campaign.campaign import Campaign as Campaign
    from tuner.campaign.settings import CampaignSettings as CampaignSettings
    from tuner.comparison.objective import objective as objective
    from tuner.comparison.plan import EvaluationRun as EvaluationRun
    from tuner.jobs import evaluate as evaluate
    from tuner.jobs import reproduce as reproduce
    from tuner.jobs import tune as tune
    from tuner.recommendation.recommendation import Recommendation as Recommendation

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "answer.answer": ["answer_of"],
        "campaign.campaign": ["Campaign"],
        "campaign.settings": ["CampaignSettings"],
        "comparison.objective": ["objective"],
        "comparison.plan": ["EvaluationRun"],
        "recommendation.recommendation": ["Recommendation"],
        "jobs": ["evaluate", "reproduce", "tune"],
    },
)
