"""What remains of a mission: the record of every adaptive capture, notes, timings, files, events for a display."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass

from nbv.config import MissionConfig
from nbv.flight import Flight
from nbv.gates import Oracle, gate_features, oracle_rewards
from nbv.mission.function import Log, no_log
from nbv.mission.observer import Observer
from nbv.mission.planning_state import save_state
from nbv.mission.result import IterationRecord
from nbv.mission.run_directory import LOCATED, RunDirectory
from nbv.stopwatch import Stopwatch
from nbv.types import CandidatePool, Capture, GateDecision, PlanningState, Ranking, UpdateReport


@dataclass(frozen=True)
class _Plan:
    """A decision, and how far the vehicle had come when it was taken."""

    state: PlanningState
    pool: CandidatePool
    rankings: dict[str, Ranking]
    decision: GateDecision
    rewards: dict[str, float]
    flight_time_s: float
    path_length_m: float


class Recorder(Observer):
    """Keeps a mission's history.

    Parameters
    ----------
    flight
        The mission's own, for the length of each leg.
    run
        Where photographs, planning states and the trace are written as they come; ``None`` writes nothing.
    oracle
        Simulation only: what it would have thought of both scorers' choices is recorded with every decision.
    """

    def __init__(
        self,
        config: MissionConfig,
        flight: Flight,
        stopwatch: Stopwatch,
        *,
        run: RunDirectory | None = None,
        oracle: Oracle | None = None,
        log: Log = no_log,
    ) -> None:
        self._config, self._flight, self._stopwatch = config, flight, stopwatch
        self._run, self._oracle, self._log = run, oracle, log
        self._plan: _Plan | None = None
        self.images = 0
        self.registered_images = 0
        self.has_model = False
        self.trace: list[IterationRecord] = []
        self.notes: list[str] = []  # what went wrong on the way without ending the mission

    def timed(self, stage: str) -> AbstractContextManager[object]:
        """Count the stage's seconds."""
        return self._stopwatch.timed(stage)

    def photographed(self, capture: Capture) -> None:
        """Keep the photograph."""
        self.images += 1
        if self._run is not None and capture.image is not None:
            self._run.write_image(capture.name, capture.image)
        if capture.viewpoint.band == "seed":
            self._log("seed", {"index": self.images - 1, "id": capture.viewpoint.id})

    def aimed_anew(self, target_m: tuple[float, float, float] | None) -> None:
        """Log the event."""
        self._log("aimed-anew", {"target_m": target_m})

    def seed_model(self, report: UpdateReport) -> None:
        """Note what became of the seeds."""
        self._count(report)
        if self.registered_images < self.images:
            self.notes.append("unregistered_seed")
        facts = {
            "points": len(report.model.points_m),
            "registered": self.registered_images,
            "captures": self.images,
            "alignment_rms_m": report.model.alignment_rms_m,
        }
        self._log("seed-model", facts)

    def located(self, config: MissionConfig | None) -> None:
        """Plan by it from now on, and keep it; note where the target was not found."""
        if config is None:
            self.notes.append("target_not_found")
            return
        self._config = config
        if self._run is not None:
            self._run.write_config(config.to_dict(), LOCATED)

    def planned(
        self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking], decision: GateDecision
    ) -> None:
        """Save the planning state; ask the oracle, where there is one, for its rewards."""
        if self._run is not None:
            save_state(self._run.state_path(state.iteration), state, pool)
        rewards: dict[str, float] = {}
        if self._oracle is not None:
            with self._stopwatch.timed("shadow_oracle"):
                rewards = oracle_rewards(self._oracle, state, pool, rankings)
        self._plan = _Plan(
            state, pool, rankings, decision, rewards, self._flight.flight_time_s, self._flight.path_length_m
        )

    def updated(self, report: UpdateReport) -> None:
        """Record the capture."""
        assert self._plan is not None, "updated() follows planned()"
        self._count(report)
        if not report.registered:
            self.notes.append("unregistered_image")
        record = self._record(self._plan, report)
        self.trace.append(record)
        if self._run is not None:
            self._run.append_trace(asdict(record))
        facts = {
            "iteration": record.iteration,
            "chosen": record.chosen,
            "scorer": record.scorer,
            "d95_m": record.d95_m,
            "registered": record.registered,
            "points": len(report.model.points_m),
        }
        self._log("capture", facts)

    def converged(self, state: PlanningState) -> None:
        """Log the event."""
        self._log("converged", {"iteration": state.iteration, "d95_m": state.d95_m})

    def pool_is_empty(self, state: PlanningState, pool: CandidatePool) -> None:
        """Record it as a note."""
        self.notes.append("empty_pool")
        self._log("empty-pool", {"iteration": state.iteration, **pool.counts})

    def returning(self) -> None:
        """Log the event."""
        self._log("dense", {})

    def _count(self, report: UpdateReport) -> None:
        self.has_model = True
        self.registered_images = len(report.model.camera_names)
        self._stopwatch.add(report.timings_s, prefix="sparse.")

    def _record(self, plan: _Plan, report: UpdateReport) -> IterationRecord:
        state, pool, decision = plan.state, plan.pool, plan.decision
        return IterationRecord(
            iteration=state.iteration,
            pool_size=len(pool),
            pool_counts=pool.counts,
            d95_m=state.d95_m,
            n_points=len(state.model.points_m),
            n_registered=len(state.model.camera_names),
            alignment_rms_m=state.model.alignment_rms_m,
            scorer=decision.ranking.scorer,
            reason=decision.reason,
            gate_details=decision.details,
            oracle_rewards=plan.rewards,
            features=gate_features(state, self._config),
            top={name: _best(ranking, pool) for name, ranking in plan.rankings.items()},
            chosen=pool.ids[decision.ranking.top],
            registered=report.registered,
            message=report.message,
            leg_duration_s=self._flight.flight_time_s - plan.flight_time_s,
            leg_length_m=self._flight.path_length_m - plan.path_length_m,
            update_s=self._stopwatch.last_s["update"],
            planning_s=self._stopwatch.last_s["planning"],
        )


def _best(ranking: Ranking, pool: CandidatePool) -> dict[str, float | str]:
    """A ranking's first candidate with its score and terms."""
    best = ranking.top
    terms = {name: float(values[best]) for name, values in ranking.terms.items()}
    return {"candidate": pool.ids[best], "score": float(ranking.scores[best]), **terms}
