"""What remains of a mission: the record of every adaptive capture, notes, timings, files, events for a display."""

from __future__ import annotations

import json
import time

from nbv.config import MissionConfig
from nbv.geometry.ply import write_ply
from nbv.mission.planning_state import save_state
from nbv.mission.result import IterationRecord, Log, no_log
from nbv.mission.run_directory import DENSE, LOCATED, PROGRESS, TRACE, RunDirectory, state_file
from nbv.planner import Plan
from nbv.process import Stopwatch
from nbv.safe_files import json_ready
from nbv.types import CandidatePool, Capture, Cloud, Point, Ranking, UpdateReport


class Recorder:
    """Sees every step of a mission, changes none, and keeps its history.

    ``config`` is what the vehicle plans by. Photographs, planning states and the trace are written into ``run`` as they come,
    or nowhere; their number goes into ``progress``. ``log`` is given a line for what was found or chosen.
    """

    def __init__(
        self,
        config: MissionConfig,
        stopwatch: Stopwatch,
        *,
        run: RunDirectory | None = None,
        progress: RunDirectory | None = None,
        log: Log = no_log,
    ) -> None:
        self.stopwatch = stopwatch
        self._run, self._progress, self._log = run, progress, log
        self._most_images = config.photographs
        self._planned_at_s = 0.0  # wall clock
        self.images = 0
        self.registered_images = 0
        self.trace: list[IterationRecord] = []
        self.shares: dict[str, float] = {}  # of the surface, as `expected` was told
        self.notes: list[str] = []  # what went wrong on the way without ending the mission

    def photographed(self, capture: Capture) -> None:
        """The vehicle arrived at a viewpoint and took a photograph: keep it."""
        with self.stopwatch.timed("files"):
            self.images += 1
            if self._run is not None and capture.image is not None:
                self._run.write_image(capture.name, capture.image)
            if self._progress is not None:
                self._progress.append(PROGRESS, f"{self.images}/{self._most_images}")

    def recentred(self, target_m: Point | None) -> None:
        """The first seeds have shown the target at this place, or None where they show none."""
        text = (
            "not found yet" if target_m is None else "found at ({:.2f}, {:.2f}, {:.2f}) m".format(*target_m)
        )
        self._log(f"target {text}")

    def seed_model(self, report: UpdateReport) -> None:
        """The seed photographs have become a sparse model."""
        self.registered_images = len(report.model.camera_names)
        if self.registered_images < self.images:
            self.notes.append("unregistered_seed")
        model = report.model
        self._log(
            f"seed model: {self.registered_images}/{self.images} images, {len(model.points_m)} points, "
            f"alignment {1000 * model.alignment_rms_m:.1f} mm"
        )

    def located(self, config: MissionConfig | None) -> None:
        """The target was looked for in the seed model: the configuration with its place and size, or None."""
        if config is None:
            self.notes.append("target_not_found")
            return
        if self._run is not None:
            self._run.write_config(config.to_dict(), LOCATED)

    def planned(self, plan: Plan) -> None:
        """The next view has been chosen: save the planning state."""
        if self._run is not None:
            with self.stopwatch.timed("files"):
                save_state(state_file(self._run.root, plan.state.iteration), plan.state, plan.pool)
        self._planned_at_s = time.perf_counter()

    def updated(self, plan: Plan, report: UpdateReport) -> None:
        """The photograph of the planned view is in the model, or could not be registered."""
        with self.stopwatch.timed("files"):
            self.registered_images = len(report.model.camera_names)
            if not report.registered:
                self.notes.append("unregistered_image")
            record = self._record(plan, report)
            self.trace.append(record)
            if self._run is not None:
                self._run.append(TRACE, json.dumps(json_ready(record)))
            number, budget = record.iteration + 1, plan.state.planned_views
            left_s = (budget - number) * (time.perf_counter() - self._planned_at_s)
            self._log(
                f"capture {number:2d} of {budget}: {record.scorer:<8} chose {record.chosen}  "
                f"d95 {1000 * record.d95_m:.0f} mm  {len(report.model.points_m)} points"
                f"{'' if record.registered else '  not registered'}"
                f"{f'  {left_s:.0f} s left, then the dense cloud' if number < budget else ''}"
            )

    def ended(self, plan: Plan) -> None:
        """The adaptive phase ends early: the cloud has converged, or no candidate passed the filters."""
        if not plan.converged:
            self.notes.append("empty_pool")

    def expected(self, shares: dict[str, float]) -> None:
        """Shares of the surface, 0 to 1, that the seeds alone and all photographs are expected to reconstruct."""
        self.shares = shares
        whole, seeds = 100 * shares["all"], 100 * shares["seeds"]
        self._log(f"expected: {whole:.0f} % of the surface, {seeds:.0f} % of the seeds alone")

    def reconstructed(self, cloud: Cloud) -> None:
        """The photographs have become a dense cloud, which will now be measured."""
        with self.stopwatch.timed("files"):
            if self._run is not None:
                write_ply(self._run.root / DENSE, cloud)

    def _record(self, plan: Plan, report: UpdateReport) -> IterationRecord:
        state, pool, decision = plan.state, plan.pool, plan.decision
        assert decision is not None, "only a chosen view is photographed"
        return IterationRecord(
            iteration=state.iteration,
            pool_counts=pool.counts,
            d95_m=state.d95_m,
            n_points=len(state.model.points_m),
            n_registered=len(state.model.camera_names),
            alignment_rms_m=state.model.alignment_rms_m,
            scorer=decision.ranking.scorer,
            reason=decision.reason,
            gate_details=decision.details,
            top={name: _best(ranking, pool) for name, ranking in plan.rankings.items()},
            chosen=pool.ids[decision.ranking.top],
            registered=report.registered,
            message=report.message,
        )


def _best(ranking: Ranking, pool: CandidatePool) -> dict[str, float | str]:
    best = ranking.top
    terms = {name: float(values[best]) for name, values in ranking.terms.items()}
    return {"candidate": pool.ids[best], "score": float(ranking.scores[best]), **terms}
