"""One objective: a mission's metric, and which way it is better."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from nbv.errors import UserError
from nbv.mission.result import value_at_path

DEFAULT_METRIC = "observable.f_score_48mm"
Direction = Literal["maximise", "minimise"]
SHORT = {
    "f_score": DEFAULT_METRIC,
    "completeness": "observable.completeness_48mm",
    "photographs": "costs.images",
    "seconds": "costs.flight_time_s",
    "energy": "costs.energy_wh",
}
PERCENTAGES = ("completeness", "accuracy", "f_score")
COUNTS = ("costs.images", "costs.registered_images")
COSTS = (*COUNTS, "costs.flight_time_s", "costs.path_length_m", "costs.energy_wh", "costs.wall_s")


def direction_of(metric: str) -> Direction:
    """Return which way a mission's metric, or a cost, is better.

    Raises `UserError`: neither an overlap (completeness, accuracy, F-score) nor a distance nor a cost: the user has
    to say it.
    """
    key = metric.rpartition(".")[2]
    if key.startswith(PERCENTAGES):
        return "maximise"
    if key.startswith(("c2c", "hausdorff")) or metric.startswith("costs."):
        return "minimise"
    raise UserError(
        f"whether more or less of {metric!r} is better is not known; say it in a settings file: "
        f"{{metric: {metric}, direction: maximise}}"
    )


def dotted(
    metrics: Mapping[str, Any], prefix: str = "", of: type | tuple[type, ...] = (int, float)
) -> Iterator[str]:
    """Return the path of every number in a mission's metrics, or of whatever is ``of`` another type."""
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}{name}.", of)
        elif isinstance(value, of):
            yield f"{prefix}{name}"


@dataclass(frozen=True)
class Objective:
    """A metric path on ``MissionResult.metrics`` and its direction."""

    metric: str = DEFAULT_METRIC
    direction: Direction = "maximise"

    def __post_init__(self) -> None:
        if self.direction not in ("maximise", "minimise"):
            raise UserError(f"unknown direction {self.direction!r}; allowed: maximise, minimise")
        if "@" in self.metric:
            first = self.metric.partition("@")[0].strip()
            raise UserError(
                f"metric {self.metric!r} has a limit, which a metric cannot have; write metric: {first}, and give the "
                f"campaign --objective {self.metric!r}"
            )
        if not self.metric:
            raise UserError(f"the objective needs a metric path such as {DEFAULT_METRIC}")

    @property
    def sign(self) -> float:
        """+1 when larger is better, else -1."""
        return 1.0 if self.direction == "maximise" else -1.0

    def oriented(self, raw: float | None) -> float | None:
        """Return a metric as measured so that larger is better; None where there is none."""
        return None if raw is None else self.sign * raw

    def measure(self, metrics: Mapping[str, Any]) -> float | None:
        """Return the metric as measured; None where it is absent or not a finite number."""
        value = value_at_path(metrics, self.metric)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return None
        return float(value)

    def value_or_reason(self, status: str, metrics: Mapping[str, Any]) -> tuple[float | None, str]:
        """Return ``(value, reason)``: the value as measured, or None with the reason why the mission is infeasible.

        A degraded mission has metrics and counts; a failed one is infeasible, never a bad number.
        """
        if status == "failed":
            return None, "mission failed"
        value = self.measure(metrics)
        if value is None:
            there = self.metric in dotted(metrics, of=object)
            return None, f"{'metric_not_a_number' if there else 'metric_missing'}: {self.metric}"
        return value, ""
