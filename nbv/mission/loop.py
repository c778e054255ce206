"""The closed loop of the paper's Fig. 1, and nothing else: what is kept of it is the recorder's business."""

from __future__ import annotations

import dataclasses

import numpy as np

from nbv.config import MissionConfig
from nbv.flight import Flight
from nbv.gates import Gate
from nbv.geometry.target import find_target
from nbv.mission.recorder import Recorder
from nbv.mission.target_prior import target_must_be_found, with_target_found
from nbv.planner import Planner
from nbv.scorers.prediction import predict
from nbv.types import Camera, Capture, Cloud, Reconstructor, SparseModel, Viewpoint
from nbv.viewpoints import RINGS, ViewpointSource


class AdaptiveMission:
    """Seed phase, adaptive phase, dense reconstruction.

    ``config`` is the vehicle's; ``recorder`` sees every step and changes none.
    """

    def __init__(
        self,
        config: MissionConfig,
        flight: Flight,
        camera: Camera,
        reconstructor: Reconstructor,
        gate: Gate,
        recorder: Recorder,
        viewpoints: ViewpointSource = RINGS,
    ) -> None:
        self.config = config
        self.flight = flight
        self.camera = camera
        self.reconstructor = reconstructor
        self.recorder = recorder
        self.planner = Planner(config, gate, viewpoints)
        self.captures: list[Capture] = []
        self._target_is_uncertain = target_must_be_found(config) and viewpoints.follows_target
        self._target_found = not self._target_is_uncertain

    def run(self) -> Cloud:
        """The whole mission: its dense cloud, or the `MissionFailure` that ended it."""
        model = self.run_seed_phase()
        self.look_for_target(model)
        model = self.run_adaptive_phase(model)
        if not self._target_found:
            self.recorder.located(None)
        if self.config.plans_on_depth:
            self.tell_expectation(model)
        return self.finish()

    def run_seed_phase(self) -> SparseModel:
        """Phase 1: the stratified ring orbit, and the seed model."""
        with self.recorder.stopwatch.timed("flight"):
            self.flight.take_off()
        seeds = self.planner.viewpoints.seeds(self.config)
        for k in range(len(seeds)):
            if k > 0 and k == self.config.seed.recentre_after and self._target_is_uncertain:
                self.recentre()
                seeds = self.planner.viewpoints.seeds(self.config)
            self._fly_and_photograph(seeds[k])
        with self.recorder.stopwatch.timed("bootstrap"):
            report = self.reconstructor.bootstrap(self.captures)
        self.recorder.seed_model(report)
        return report.model

    def recentre(self) -> None:
        """Place the remaining seeds around the target that the photographs so far show, if they show one."""
        with self.recorder.stopwatch.timed("partial_model"):
            model = self.reconstructor.partial_model(self.captures)
        target_m = None
        if model is not None:
            target = find_target(model.points_m, self.config.target_m, model.camera_centers_m)
            if target is not None:
                target_m = target.center_m
                self._recentre_on(self.config.changed(target_m=target_m))
        self.recorder.recentred(target_m)

    def look_for_target(self, model: SparseModel) -> None:
        """From now on the target is where, and as large as, the model shows it; until one shows it, as assumed."""
        with self.recorder.stopwatch.timed("target"):
            config = None if self._target_found else with_target_found(self.config, model)
        if config is not None:
            self._target_found = True
            self._recentre_on(config)
            self.recorder.located(config)

    def _recentre_on(self, config: MissionConfig) -> None:
        self.config = config
        self.planner = Planner(config, self.planner.gate.recentred(config), self.planner.viewpoints)
        self.flight.face(config.target_m, config.flight)
        self.camera.aim_at(config.target_m)
        self.reconstructor.recentre(config.target_m, config.dense.crop_half_width_m)

    def run_adaptive_phase(self, model: SparseModel) -> SparseModel:
        """Phase 2: plan, fly, photograph, update, until the budget is used or the cloud has converged; the last model."""
        for _ in range(self.config.planned_views):
            with self.recorder.stopwatch.timed("planning"):
                plan = self.planner.plan(
                    model,
                    np.array([capture.viewpoint.position_m for capture in self.captures]),
                    sum(capture.viewpoint.band == "seed" for capture in self.captures),
                    self.flight.position_m,
                    self.flight.heading_rad,
                )
            view = plan.next_view
            if view is None:
                self.recorder.ended(plan)
                return model
            self.recorder.planned(plan)
            if self.config.flight.planning_s > 0:
                with self.recorder.stopwatch.timed("flight"):
                    self.flight.hover(self.config.flight.planning_s)
            # A view is revisited, or the pool has moved with the target.
            while view.id in {capture.viewpoint.id for capture in self.captures}:
                view = dataclasses.replace(view, id=f"{view.id}b")
            capture = self._fly_and_photograph(view)
            with self.recorder.stopwatch.timed("update"):
                report = self.reconstructor.add(capture)
            self.recorder.updated(plan, report)
            model = report.model
            self.look_for_target(model)
        return model

    def tell_expectation(self, model: SparseModel) -> None:
        """How much of the surface the seeds alone and all photographs are expected to reconstruct."""
        with self.recorder.stopwatch.timed("planning"):
            prediction = predict(model, self.config)
            places_m = np.array([capture.viewpoint.position_m for capture in self.captures])
            seeds = [capture.viewpoint.band == "seed" for capture in self.captures]
            views = {"seeds": places_m[seeds], "all": model.camera_centers_m}
            shares = {name: prediction.expected_share(of) for name, of in views.items()}
        self.recorder.expected(shares)

    def finish(self) -> Cloud:
        """Fly home, then reconstruct the dense cloud."""
        with self.recorder.stopwatch.timed("flight"):
            self.flight.return_and_land()
        with self.recorder.stopwatch.timed("scene"):
            self.camera.close()
        with self.recorder.stopwatch.timed("dense"):
            return self.reconstructor.finish()

    def _fly_and_photograph(self, viewpoint: Viewpoint) -> Capture:
        """Photograph the target from where the vehicle really arrives."""
        with self.recorder.stopwatch.timed("flight"):
            position_m = self.flight.fly_to(viewpoint)
        with self.recorder.stopwatch.timed("photograph"):
            capture = self.camera.take_photograph(viewpoint, position_m, self.flight.flight_time_s)
        self.captures.append(capture)
        self.recorder.photographed(capture)
        return capture
