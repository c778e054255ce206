"""Missions with photographs: rendered views, COLMAP in flight, stereo and fusion after it."""

from __future__ import annotations

from typing import Any, ClassVar

from nbv.cache import cached_json
from nbv.config import CameraConfig
from nbv.evaluation import Evaluation, camera_shell, evaluate_cloud
from nbv.mission.fidelity import Fidelity, MissionContext
from nbv.mission.run_directory import RunDirectory
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.plugins import plugins, sources
from nbv.scene import Renderer, build_scene, make_renderer
from nbv.terrain import make_surroundings
from nbv.threads import limit_threads
from nbv.types import Cloud


class PhotogrammetricFidelity(Fidelity):
    """Rendered photographs, structure from motion, dense stereo."""

    name = "photogrammetric"
    reconstructor: PhotogrammetricReconstructor
    evaluation_code: ClassVar[str] = "nbv.evaluation"  # the package that evaluates
    _cloud: Cloud
    _evaluation: Evaluation | None = None  # of the cloud, where it was not known

    def __init__(self, context: MissionContext) -> None:
        limit_threads()
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
        """Clean the cloud and compare it with the true rock."""
        return evaluate_cloud(cloud, self.context.rock, self.context.config, self.context.store)

    def evaluation_inputs(self) -> list[Any]:
        """What decides an evaluation beside the cloud."""
        config = self.context.config
        return [
            self.context.rock.sha256,
            config.evaluation,
            list(config.target_m),
            config.dense.fusion_voxel_m,
            config.telemetry.is_exact,
            config.ground,
            config.scene.ground_seed,
            camera_shell(config),
            *sources("metrics", *sorted(plugins("metrics"))),
        ]

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        """What `evaluate` says; the metrics of a known cloud are kept, failures are not."""
        self._cloud = cloud

        def evaluated() -> dict[str, Any]:
            self._evaluation = self.evaluate(cloud)
            return self._evaluation.metrics

        inputs = [self.reconstructor.cloud_key, *self.evaluation_inputs()]
        with self.context.stopwatch.timed("evaluation"):
            found: dict[str, Any] = cached_json(
                self.context.store, "evaluations", evaluated, code=self.evaluation_code, inputs=inputs
            )
        return found

    def export(self, run: RunDirectory, metrics: dict[str, Any]) -> None:
        """The cleaned cloud, how it was cleaned, and the sparse model."""
        if metrics:
            evaluation = self._evaluation or self.evaluate(self._cloud)
            run.write_cloud("cleaned.ply", evaluation.cleaned)
            run.write_json("metrics.json", {"metrics": metrics, "cleaning": evaluation.cleaning})
        if self.reconstructor.has_model:
            self.reconstructor.export_sparse(run.sparse_model, run.images)

    def _renderer(self, camera: CameraConfig) -> Renderer:
        config = self.context.config
        with self.context.stopwatch.timed("scene"):
            rock, store = self.context.rock, self.context.store
            around = make_surroundings(config.ground, config.scene.ground_seed, rock.sha256, store)
            scene = build_scene(rock, config.scene, camera, store=store, surroundings=around)
            return make_renderer(scene, config.scene.backend)


# Run one complete mission with photographs and measure its cloud: a `nbv.mission.MissionFunction`.
run_photogrammetric_mission = PhotogrammetricFidelity.run
