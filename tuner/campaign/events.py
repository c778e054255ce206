"""What a campaign tells while it runs and when it ends: events, counts, the summary of a session."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tuner.missions.job import Trial
from tuner.recommendation.recommendation import Recommendation

EventKind = Literal[
    "launched",
    "finished",
    "failed",
    "lost",  # the machine ended the mission; its trial stays open
    "recommendation",
    "interrupted",
    "stopped",
    "done",
]
Ending = Literal["budget", "interrupted", "failing", "exhausted"]


@dataclass(frozen=True)
class CampaignEvent:
    kind: EventKind
    elapsed_s: float  # since this session began
    finished: int  # missions finished so far, failed ones included, repeats left out
    budget: int
    trial: Trial | None = None
    recommendation: Recommendation | None = None
    message: str = ""


@dataclass(frozen=True)
class CampaignStatus:
    name: str
    budget: int
    complete: int
    failed: int
    running: int  # in flight, or interrupted and waiting for a resume
    per_rock: dict[str, int]
    per_condition: dict[str, int]
    failures: dict[str, int]  # by reason
    mission_wall_s: float
    repeats: int = 0  # trials that took the photographs of an earlier one: they use no budget
    exhausted: str = ""  # why the search ended before the budget was used, so that a resume runs nothing

    @property
    def finished(self) -> int:
        """Missions with an outcome, failures included, repeats left out."""
        return self.complete + self.failed - self.repeats

    @property
    def remaining(self) -> int:
        return max(0, self.budget - self.finished)


@dataclass(frozen=True)
class CampaignSummary:
    """How one session (``run_campaign``) ended."""

    stopped: Ending
    message: str
    elapsed_s: float
    ask_s: float  # spent by the sampler
    status: CampaignStatus
    recommendation: Recommendation | None

    @property
    def found(self) -> bool:
        """Whether the search has come to its end, with a recommendation."""
        return self.stopped in ("budget", "exhausted") and self.recommendation is not None
