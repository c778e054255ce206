"""Missions with photographs: rendered views, COLMAP in flight, stereo and fusion after it."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from nbv.cache import cached_json
from nbv.config import CameraConfig
from nbv.evaluation import Evaluation, evaluate_cloud
from nbv.evaluation.registry import METRIC_REGISTRY
from nbv.geometry.ply import write_ply
from nbv.mission.fidelity import Fidelity, MissionContext
from nbv.mission.run_directory import CLEANED, CLEANING, IMAGES, SPARSE_MODEL, RunDirectory
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.process import limit_threads
from nbv.scene import Renderer, build_scene, make_renderer
from nbv.types import Cloud
from nbv.viewpoints import camera_shell

# What missions with photographs have in common, rendered or really taken: a cloud that is cleaned and compared.


class CloudFidelity(Fidelity):
    """Structure from motion, dense stereo, and the cloud's metrics, which are kept in the store."""

    reconstructor: PhotogrammetricReconstructor
    evaluation_code: ClassVar[str]  # the package that evaluates
    _cloud: Cloud
    _evaluation: Evaluation | None = None  # of the cloud, where it was not known

    def __init__(self, context: MissionContext) -> None:
        limit_threads()
        super().__init__(context)

    @abstractmethod
    def evaluate(self, cloud: Cloud) -> Evaluation:
        """Clean the cloud and compare it with what is true."""

    @abstractmethod
    def evaluation_inputs(self) -> list[Any]:
        """What decides an evaluation beside the cloud and the metrics of plug-ins."""

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        self._cloud = cloud

        def evaluated() -> dict[str, Any]:
            self._evaluation = self.evaluate(cloud)
            return self._evaluation.metrics

        inputs = [
            self.reconstructor.cloud_key,
            *self.evaluation_inputs(),
            *METRIC_REGISTRY.sources(*sorted(METRIC_REGISTRY.plugins())),
        ]
        with self.context.stopwatch.timed("evaluation"):
            metrics: dict[str, Any] = cached_json(
                self.context.store, "evaluations", evaluated, code=self.evaluation_code, inputs=inputs
            )
        return metrics

    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        if metrics:
            evaluation = self._evaluation or self.evaluate(self._cloud)
            write_ply(run.root / CLEANED, evaluation.cleaned)
            run.write_json(CLEANING, evaluation.cleaning)
        if self.reconstructor.has_model:
            self.reconstructor.export_sparse(run.root / SPARSE_MODEL, run.root / IMAGES)


class PhotogrammetricFidelity(CloudFidelity):
    """Rendered photographs, structure from motion, dense stereo."""

    name = "photogrammetric"
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
