"""Missions with photographs: rendered views, COLMAP in flight, stereo and fusion after it."""

from __future__ import annotations

from typing import Any

from nbv.config import CameraConfig
from nbv.evaluation import Evaluation, evaluate_cloud
from nbv.mission.fidelity import MissionContext
from nbv.photogrammetric.cloud_fidelity import CloudFidelity
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.scene import Renderer, build_scene, make_renderer
from nbv.types import Cloud
from nbv.viewpoints import camera_shell


class PhotogrammetricFidelity(CloudFidelity):
    """Rendered photographs, structure from motion, dense stereo."""

    name = "photogrammetric"
    unnoticed = ("scene.match_angle_deg",)
    evaluation_code = "nbv.evaluation"

    def __init__(self, context: MissionContext) -> None:
        super().__init__(context)
        config, store = context.config, context.store
        self.camera = SimulatedCamera(
            self._renderer, context.rock, context.replicate, self.vehicle_config, store
        )
        self.reconstructor = PhotogrammetricReconstructor(
            self.vehicle_config, store, keep_sparse=context.keeps_everything, stopwatch=context.stopwatch
        )
        self.facts = {"backend": config.scene.backend, "dense_backend": config.dense.backend}

    def evaluate(self, cloud: Cloud) -> Evaluation:
        return evaluate_cloud(cloud, self.context.rock, self.context.config, self.context.store)

    def evaluation_inputs(self) -> list[Any]:
        config = self.context.config
        return [
            self.context.rock.sha256,
            config.evaluation,
            list(config.target_m),
            config.dense.fusion_voxel_m,
            config.telemetry.places_well,
            camera_shell(config),
        ]

    def _renderer(self, camera: CameraConfig) -> Renderer:
        config = self.context.config
        with self.context.stopwatch.timed("scene"):
            scene = build_scene(self.context.rock, config.scene, camera, store=self.context.store)
            return make_renderer(scene, config.scene.backend)


# Run one complete mission with photographs and measure its cloud: a `nbv.mission.MissionFunction`.
run_photogrammetric_mission = PhotogrammetricFidelity.run
