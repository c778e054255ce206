"""The closed loop of the paper's Fig. 1, and nothing else: what is recorded of it is the observer's business."""

from __future__ import annotations

import dataclasses

import numpy as np

from nbv.config import MissionConfig
from nbv.flight import Flight
from nbv.gates import Gate
from nbv.geometry.target import find_target
from nbv.mission.belief import located, must_look
from nbv.mission.observer import Observer
from nbv.planner import Plan, Planner
from nbv.types import Camera, Capture, Cloud, Reconstructor, SparseModel, Viewpoint
from nbv.viewpoints import RINGS, ViewpointSource


class AdaptiveMission:
    """Seed phase, adaptive phase, dense reconstruction.

    Parameters
    ----------
    observer
        Sees every step as it happens; the mission goes the same way without one.
    viewpoints
        Where photographs may be taken.
    """

    def __init__(
        self,
        config: MissionConfig,
        flight: Flight,
        camera: Camera,
        reconstructor: Reconstructor,
        gate: Gate,
        observer: Observer | None = None,
        viewpoints: ViewpointSource = RINGS,
    ) -> None:
        self.config = config
        self.flight = flight
        self.camera = camera
        self.reconstructor = reconstructor
        self.planner = Planner(config, gate, viewpoints)
        self.observer = observer if observer is not None else Observer()
        self.captures: list[Capture] = []

    def fly(self) -> Cloud:
        """The whole mission: its dense cloud, or the `MissionFailure` that ended it."""
        model = self.fly_seed_phase()
        if self._must_look():
            self.look_for_target(model)
        self.fly_adaptive_phase(model)
        return self.finish()

    def fly_seed_phase(self) -> SparseModel:
        """Phase 1: the stratified ring orbit, and the seed model."""
        self.flight.take_off()
        seeds = self.planner.viewpoints.seeds(self.config)
        for k in range(len(seeds)):
            if k > 0 and k == self.config.seed.reaim_after and self._must_look():
                self.aim_anew()
                seeds = self.planner.viewpoints.seeds(self.config)
            self._fly_and_photograph(seeds[k])
        with self.observer.timed("bootstrap"):
            report = self.reconstructor.bootstrap(self.captures)
        self.observer.seed_model(report)
        return report.model

    def _must_look(self) -> bool:
        return must_look(self.config) and self.planner.viewpoints.follows_target

    def aim_anew(self) -> None:
        """The other seeds are flown around the target as the photographs so far show it; as before if they show none."""
        with self.observer.timed("glimpse"):
            model = self.reconstructor.glimpse(self.captures)
        found = (
            None
            if model is None
            else find_target(model.points_m, self.config.target_m, model.camera_centers_m)
        )
        if found is not None:
            self._turn_to_target(dataclasses.replace(self.config, target_m=found.center_m))
        self.observer.aimed_anew(None if found is None else found.center_m)

    def look_for_target(self, model: SparseModel) -> None:
        """From now on the target is where, and as large as, the model shows it; as believed if it shows none."""
        config = located(self.config, model)
        if config is not None:
            self._turn_to_target(config)
        self.observer.located(config)

    def _turn_to_target(self, config: MissionConfig) -> None:
        self.config = config
        self.flight.face(config.target_m, config.flight)
        self.camera.aim_at(config.target_m)
        self.reconstructor.retarget(config.target_m, config.dense.crop_half_width_m)
        self.planner = Planner(config, self.planner.gate.retargeted(config), self.planner.viewpoints)

    def fly_adaptive_phase(self, model: SparseModel) -> None:
        """Phase 2: plan, fly, photograph, update, until the budget is used or the cloud has converged."""
        for _ in range(self.config.adaptive_budget):
            with self.observer.timed("planning"):
                plan = self._plan(model)
            view = plan.next_view
            if view is None or plan.pool is None or plan.rankings is None or plan.decision is None:
                if plan.pool is None:
                    self.observer.converged(plan.state)
                else:
                    self.observer.pool_is_empty(plan.state, plan.pool)
                return
            self.observer.planned(plan.state, plan.pool, plan.rankings, plan.decision)
            if self.config.flight.planning_s > 0:
                self.flight.hover(self.config.flight.planning_s)
            capture = self._fly_and_photograph(view)
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

    def _plan(self, model: SparseModel) -> Plan:
        return self.planner.plan(
            model,
            np.array([capture.viewpoint.position_m for capture in self.captures]),
            sum(capture.viewpoint.band == "seed" for capture in self.captures),
            self.flight.position_m,
            self.flight.heading_rad,
        )
