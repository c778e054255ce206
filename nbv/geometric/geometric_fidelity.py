"""A complete mission in milliseconds: the same loop, scorers, gates and flight over simulated tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from nbv.cache import code_digest
from nbv.config import MissionConfig, TelemetryConfig
from nbv.geometric.completeness import predicted_metrics
from nbv.geometric.reconstructor import GeometricReconstructor
from nbv.geometric.world import world_of
from nbv.geometry.frames import look_at
from nbv.mission.fidelity import Fidelity, MissionContext
from nbv.rocks import load_coarse_rock
from nbv.scorers.prediction import predict
from nbv.types import Camera, Capture, Cloud, Floats, UpdateReport, Viewpoint


class PoseCamera(Camera):
    """No images: a photograph is where it was taken from."""

    def take_photograph(self, viewpoint: Viewpoint, position_m: Floats, time_s: float) -> Capture:
        pose = look_at(position_m, np.array(self.target_m))
        return Capture(f"{viewpoint.id}.png", viewpoint, pose, None)


class GeometricFidelity(Fidelity):
    """The mission's completeness is predicted. Telemetry is exact and the target's place known, whatever is configured."""

    name = "geometric"
    unnoticed = (
        *("scene.backend", "scene.sky_grey", "scene.read_noise_dn", "scene.shot_noise_dn", "sensor."),
        *("telemetry.", "target.horizontal_sd_m", "target.vertical_sd_m", "scene.ground_seed"),
        *("sparse.max_features", "sparse.first_octave", "sparse.peak_threshold", "sparse.match_ratio"),
        *("sparse.max_pairs", "sparse.min_ransac_trials", "sparse.global_ba", "sparse.local_ba"),
        *("sparse.update_pairs", "sparse.max_alignment_rms_m"),
        *("dense.backend", "dense.min_baseline_angle_deg", "dense.crop_half_width_m", "dense.search"),
        *("dense.max_size_px", "dense.patchmatch_", "dense.consistency_px", "dense.fusion_voxel_m"),
        *("dense.consistency_relative_depth", "evaluation.crop", "evaluation.ground", "evaluation.sor"),
        *("evaluation.floater_radius_m", "evaluation.gt_"),
    )
    load = staticmethod(load_coarse_rock)
    reconstructor: GeometricReconstructor
    reconstructs: ClassVar[type[GeometricReconstructor]] = GeometricReconstructor

    @staticmethod
    def simulated(config: MissionConfig) -> MissionConfig:
        known = replace(config.target, horizontal_sd_m=0.0, vertical_sd_m=0.0)
        return config.changed(telemetry=TelemetryConfig(), target=known)

    def __init__(self, context: MissionContext) -> None:
        super().__init__(context)
        config, rock, aim_m = context.config, context.rock, self.vehicle_config.target_m
        self._world = world_of(rock, config, context.store)
        self.camera = PoseCamera(aim_m)
        self.reconstructor = self.reconstructs(self._world, config, aim_m, rock.sha256, context.replicate)
        self.facts = {"geometric_code": code_digest(__package__)}

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """Predicted scores; ``metrics["fidelity"]`` says that they are."""
        with self.context.stopwatch.timed("evaluation"):
            return predicted_metrics(self._world, self.reconstructor.predicted(), self.context.config)


# Run one mission without images and predict its completeness: a `nbv.mission.MissionFunction`.
run_geometric_mission = GeometricFidelity.run


# A geometric mission that is measured after every photograph: quality over number from one flight.


class _MeasuredReconstructor(GeometricReconstructor):
    """After the seeds and after every view, the F-score at 48 mm and what the vehicle would predict of it, in percent."""

    fidelity: CurveFidelity

    @property
    def _draws_depth(self) -> bool:
        return self._config.planned_views > 0  # the prediction needs it

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        return self.fidelity.note(super().bootstrap(captures), len(captures))

    def add(self, capture: Capture) -> UpdateReport:
        return self.fidelity.note(super().add(capture), self.fidelity.curve[-1][0] + 1)


class CurveFidelity(GeometricFidelity):
    """``metrics["curve"]`` has, for each number of photographs, that number, the F-score and its prediction, in percent.

    A mission that plans nothing has the end alone, and predicts nothing.
    """

    name = "curve"
    reconstructor: _MeasuredReconstructor
    reconstructs = _MeasuredReconstructor

    def __init__(self, context: MissionContext) -> None:
        super().__init__(context)
        self.curve: list[tuple[int, float, float]] = []
        self.reconstructor.fidelity = self

    def note(self, report: UpdateReport, photographs: int) -> UpdateReport:
        """Measure what the photographs so far make of the target."""
        config, predicted = self.context.config, 0.0
        if config.planned_views > 0:
            predicted = predict(report.model, self.vehicle_config).f_score_percent
        scores = predicted_metrics(self._world, self.reconstructor.predicted(), config)
        self.curve.append((photographs, scores["observable"]["f_score_48mm"], predicted))
        return report

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        return {**super().measure(cloud), "curve": [list(step) for step in self.curve]}


# A `nbv.mission.MissionFunction`.
run_curve_mission = CurveFidelity.run
