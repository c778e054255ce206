"""What missions with photographs have in common, rendered or really taken: a cloud that is cleaned and compared."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from nbv.cache import cached_json
from nbv.evaluation import Evaluation
from nbv.evaluation.registry import METRIC_REGISTRY
from nbv.geometry.ply import write_ply
from nbv.mission.fidelity import Fidelity, MissionContext
from nbv.mission.run_directory import CLEANED, CLEANING, RunDirectory
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.threads import limit_threads
from nbv.types import Cloud


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
            self.reconstructor.export_sparse(run.sparse_model, run.images)
