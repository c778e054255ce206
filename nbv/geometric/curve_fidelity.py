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

    A mission that plans nothing has the end alone.
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
        if self.context.config.adaptive_budget > 0:
            scores = predicted_metrics(self._world, self.reconstructor.predicted(), self.context.config)
            predicted = predict(report.model, self.vehicle_config).f_score_percent
            self.curve.append((photographs, scores["observable"]["f_score_48mm"], predicted))
        else:
            self.curve.append((photographs, 0.0, 0.0))
        return report

    def measure(self, cloud: Cloud) -> dict[str, Any]:
        metrics = super().measure(cloud)
        if self.context.config.adaptive_budget == 0:
            self.curve = [(self.curve[-1][0], metrics["observable"]["f_score_48mm"], 0.0)]
        metrics["curve"] = [list(step) for step in self.curve]
        return metrics


# A `nbv.mission.MissionFunction`.
run_curve_mission = CurveFidelity.run
