"""The closed loop of the paper's Fig. 1, and nothing else: what is recorded of it is the observer's business."""

from __future__ import annotations

from nbv.config import MissionConfig
from nbv.flight import Flight
from nbv.gates import Gate
from nbv.mission.belief import located, must_look
from nbv.mission.observer import Observer
from nbv.mission.planning_state import planning_state
from nbv.scorers import rank_candidates
from nbv.types import Camera, Capture, Cloud, PlanningState, Reconstructor, SparseModel, Viewpoint
from nbv.viewpoints import candidate_pool, seed_viewpoints


class AdaptiveMission:
    """Seed phase, adaptive phase, dense reconstruction.

    Parameters
    ----------
    observer
        Sees every step as it happens; the mission goes the same way without one.
    """

    def __init__(
        self,
        config: MissionConfig,
        flight: Flight,
        camera: Camera,
        reconstructor: Reconstructor,
        gate: Gate,
        observer: Observer | None = None,
    ) -> None:
        self.config = config
        self.flight = flight
        self.camera = camera
        self.reconstructor = reconstructor
        self.gate = gate
        self.observer = observer if observer is not None else Observer()
        self.captures: list[Capture] = []

    def fly(self) -> Cloud:
        """The whole mission: its dense cloud, or the `MissionFailure` that ended it."""
        model = self.fly_seed_phase()
        if must_look(self.config):
            self.look_for_target(model)
        self.fly_adaptive_phase(model)
        return self.finish()

    def fly_seed_phase(self) -> SparseModel:
        """Phase 1: the stratified ring orbit, and the seed model."""
        self.flight.take_off()
        for viewpoint in seed_viewpoints(self.config):
            self._fly_and_photograph(viewpoint)
        with self.observer.timed("bootstrap"):
            report = self.reconstructor.bootstrap(self.captures)
        self.observer.seed_model(report)
        return report.model

    def look_for_target(self, model: SparseModel) -> None:
        """From now on the target is where, and as large as, the model shows it; as believed if it shows none."""
        config = located(self.config, model)
        if config is not None:
            self.config = config
            self.flight.face(config.target_m)
            self.camera.aim_at(config.target_m)
            self.reconstructor.retarget(config.target_m, config.dense.crop_half_width_m)
            self.gate = self.gate.retargeted(config)
        self.observer.located(config)

    def fly_adaptive_phase(self, model: SparseModel) -> None:
        """Phase 2: plan, fly, photograph, update, until the budget is used or the cloud has converged."""
        for iteration in range(self.config.stop.adaptive_budget):
            with self.observer.timed("planning"):
                state = planning_state(self.config, model, self.captures, self.flight, iteration)
                if self._converged(state):
                    self.observer.converged(state)
                    return
                pool = candidate_pool(self.config, state.vehicle_position_m, state.visited_m[state.n_seeds :])
                if len(pool) == 0:
                    self.observer.pool_is_empty(state, pool)
                    return
                rankings = rank_candidates(state, pool, self.config)
                decision = self.gate.decide(state, pool, rankings)
            self.observer.planned(state, pool, rankings, decision)
            capture = self._fly_and_photograph(pool.viewpoint(decision.ranking.top))
            with self.observer.timed("update"):
                report = self.reconstructor.add(capture)
            self.observer.updated(report)
            model = report.model

    def finish(self) -> Cloud:
        """Fly home, then reconstruct the dense cloud."""
        self.observer.returning()
        self.flight.return_and_land()
        self.camera.close()
        with self.observer.timed("dense"):
            return self.reconstructor.finish()

    def _fly_and_photograph(self, viewpoint: Viewpoint) -> Capture:
        """Photograph the target from where the vehicle really arrives."""
        position_m = self.flight.fly_to(viewpoint)
        with self.observer.timed("photograph"):
            capture = self.camera.take_photograph(viewpoint, position_m, self.flight.flight_time_s)
        self.captures.append(capture)
        self.observer.photographed(capture)
        return capture

    def _converged(self, state: PlanningState) -> bool:
        stop = self.config.stop
        return stop.criterion in ("both", "knn") and state.d95_m <= stop.knn_threshold_m
