"""From a mission's metrics to the number that is optimised."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from nbv.errors import UserError

DEFAULT_METRIC = "observable.f_score_48mm"
Direction = Literal["maximise", "minimise"]
_SHARE = re.compile(r"P\((?P<metric>[\w.]+)>=(?P<least>[^()]+)\)", re.ASCII)


def reached(metric: str) -> tuple[str, float] | None:
    """Return ``(metric, least)`` of a share's path, such as ``P(observable.f_score_48mm>=98)``; None of any other.

    A mission has 100 or 0 of it, so that its mean over rocks is the share of rocks that reach it, in percent.
    """
    found = _SHARE.fullmatch(metric)
    return (found["metric"], float(found["least"])) if found else None


def direction_of(metric: str) -> Direction:
    """Return which way a mission's metric, or a cost, is better.

    Raises
    ------
    UserError
        Neither an overlap (completeness, accuracy, F-score) nor a distance nor a cost: the user has to say it.
    """
    if reached(metric):
        return "maximise"
    key = metric.rpartition(".")[2]
    if key.startswith(("completeness", "accuracy", "f_score", "tt_")):
        return "maximise"
    if key.startswith(("c2c", "hausdorff")) or metric.startswith("costs."):
        return "minimise"
    raise UserError(
        f"whether more or less of {metric!r} is better is not known; say it in a settings file: "
        f"{{metric: {metric}, direction: maximise}}"
    )


def dotted(metrics: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Return the path of every number in a mission's metrics."""
    for name, value in metrics.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}{name}.")
        elif isinstance(value, (int, float)):
            yield f"{prefix}{name}"


@dataclass(frozen=True)
class Objective:
    """A metric path on ``MissionResult.metrics`` and its direction."""

    metric: str = DEFAULT_METRIC
    direction: Direction = "maximise"

    def __post_init__(self) -> None:
        if self.direction not in ("maximise", "minimise"):
            raise UserError(f"unknown direction {self.direction!r}; allowed: maximise, minimise")
        if not self.metric:
            raise UserError(f"the objective needs a metric path such as {DEFAULT_METRIC}")

    @property
    def sign(self) -> float:
        """+1 when larger is better, else -1."""
        return 1.0 if self.direction == "maximise" else -1.0

    def measure(self, metrics: Mapping[str, Any]) -> float | None:
        """Return the metric as measured, a share (`reached`) as 100 or 0; None where it is absent or not a finite number."""
        if share := reached(self.metric):
            value = Objective(share[0]).measure(metrics)
            return None if value is None else 100.0 * (value >= share[1])
        node: Any = metrics
        parts = self.metric.split(".")
        if (
            parts[0] == "registered" and "registered" not in metrics
        ):  # telemetry is exact: nothing to register
            parts = parts[1:]
        for part in parts:
            if not isinstance(node, Mapping) or part not in node:
                return None
            node = node[part]
        if isinstance(node, bool) or not isinstance(node, (int, float)) or not math.isfinite(node):
            return None
        return float(node)

    @property
    def is_share(self) -> bool:
        """Whether it is the share of rocks that reach something."""
        return reached(self.metric) is not None

    def outcome(self, status: str, metrics: Mapping[str, Any]) -> tuple[float | None, str]:
        """Return ``(value, reason)``: the value as measured, or None with the reason why the mission is infeasible.

        A degraded mission has metrics and counts; a failed one is infeasible, never a bad number.
        """
        if status == "failed":
            return None, "mission failed"
        value = self.measure(metrics)
        if value is None:
            return None, f"metric_missing: {self.metric}"
        return value, ""
