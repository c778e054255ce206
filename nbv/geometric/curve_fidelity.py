"""A geometric mission that is measured after every photograph: quality over number from one flight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nbv.geometric.completeness import predicted_metrics
from nbv.geometric.geometric_fidelity import GeometricFidelity
from nbv.geometric.reconstructor import GeometricReconstructor
from nbv.mission.fidelity import MissionContext
from nbv.scorers.prediction import predict
from nbv.types import Capture, Cloud, UpdateReport


class _MeasuredReconstructor(GeometricReconstructor):
    """After the seeds and after every view, the F-score at 48 mm and what the vehicle would predict of it, in percent."""

    fidelity: CurveFidelity

    @property
    def _draws_depth(self) -> bool:
        return self._config.adaptive_budget > 0  # the prediction needs it

    def bootstrap(self, captures: Sequence[Capture]) -> UpdateReport:
        return self.fidelity.note(super().bootstrap(captures), len(captures))

    def add(self, capture: Capture) -> UpdateReport:
        return self.fidelity.note(super().add(capture), self.fidelity.curve[-1][0] + 1)


class CurveFidelity(GeometricFidelity):
    """``metrics["curve"]`` has, for each number of photographs, that number, the F-score and its prediction, in percent.

    A mission that plans nothing has the end alone, and predicts nothing.
    """

    name = "curve"

    def __init__(self, context: MissionContext) -> None:
        super().__init__(context)
        config, rock = context.config, context.rock
        self.curve: list[tuple[int, float, float]] = []
        self.reconstructor = _MeasuredReconstructor(
            self._world, config, self.vehicle_config.target_m, rock.sha256, context.replicate
        )
        self.reconstructor.fidelity = self

    def note(self, report: UpdateReport, photographs: int) -> UpdateReport:
        """Measure what the photographs so far make of the target."""
        config, predicted = self.context.config, 0.0
        if config.adaptive_budget > 0:
            predicted = predict(report.model, self.vehicle_config).f_score_percent
        scores = predicted_metrics(self._world, self.reconstructor.predicted(), config)
        self.curve.append((photographs, scores["observable"]["f_score_48mm"], predicted))
        return report

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        return {**super().measure(cloud), "curve": [list(step) for step in self.curve]}


# A `nbv.mission.MissionFunction`.
run_curve_mission = CurveFidelity.run
