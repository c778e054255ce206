"""What can be watched of a mission while it flies."""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager

from nbv.config import MissionConfig
from nbv.types import CandidatePool, Capture, GateDecision, PlanningState, Ranking, UpdateReport


class Observer:
    """Sees every step of a mission and changes none; a subclass overrides what it wants to see."""

    def timed(self, stage: str) -> AbstractContextManager[object]:
        """Entered before a stage of the mission and left after it."""
        return contextlib.nullcontext()

    def photographed(self, capture: Capture) -> None:
        """The vehicle arrived at a viewpoint and took a photograph."""

    def aimed_anew(self, target_m: tuple[float, float, float] | None) -> None:
        """The first seeds have shown the target there, or not at all."""

    def seed_model(self, report: UpdateReport) -> None:
        """The seed photographs have become a sparse model."""

    def located(self, config: MissionConfig | None) -> None:
        """The target was looked for in the seed model: the configuration with its place and size, or None."""

    def planned(
        self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking], decision: GateDecision
    ) -> None:
        """The next view has been chosen; the vehicle has not left yet."""

    def updated(self, report: UpdateReport) -> None:
        """The photograph of the chosen view is in the model, or could not be registered."""

    def converged(self, state: PlanningState) -> None:
        """The cloud is as dense as the stopping rule asks; the adaptive phase ends."""

    def pool_is_empty(self, state: PlanningState, pool: CandidatePool) -> None:
        """No candidate passed the filters; the adaptive phase ends."""

    def returning(self) -> None:
        """The last photograph has been taken."""
