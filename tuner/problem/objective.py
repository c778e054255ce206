"""What is optimised: a mission's metric, alone or under a limit of another, and the text that asks for it.

- ``f_score``: one objective;
- ``f_score@photographs<=21``: the best quality at no more than so much of a cost;
- ``photographs@f_score>=97``: the least cost of a quality that is asked for;
- ``photographs@P(f_score>=98)>=0.95``: the least cost with which so large a share of rocks reaches a quality.

A name is a metric's path, or one of `SHORT`.
"""

from __future__ import annotations

import contextlib
import math
import re
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
COUNTS = ("costs.images", "costs.registered_images")
COSTS = (*COUNTS, "costs.flight_time_s", "costs.path_length_m", "costs.energy_wh", "costs.wall_s")
# Of a text without blanks around its signs.
_NAME, _NUMBER = r"P\([^()]*\)|[\w.]+", r"[-+.\deE]+"
_FORM = re.compile(rf"(?P<first>{_NAME})(@(?P<second>{_NAME})(?P<sign><=|>=)(?P<limit>{_NUMBER}))?", re.ASCII)
_SHARE = re.compile(rf"P\((?P<metric>[\w.]+)>=(?P<least>{_NUMBER})\)", re.ASCII)


def reached(metric: str) -> tuple[str, float] | None:
    """Return ``(metric, least)`` of a share's path, such as ``P(observable.f_score_48mm>=98)``; None of any other.

    A mission has 100 or 0 of it, so that its mean over rocks is the share of rocks that reach it, in percent.
    """
    found = _SHARE.fullmatch(metric)
    return (found["metric"], float(found["least"])) if found else None


def direction_of(metric: str) -> Direction:
    """Return which way a mission's metric, or a cost, is better.

    Raises `UserError`: neither an overlap (completeness, accuracy, F-score) nor a distance nor a cost: the user has
    to say it.
    """
    if reached(metric):
        return "maximise"
    key = metric.rpartition(".")[2]
    if key.startswith(("completeness", "accuracy", "f_score")):
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
        """Return the metric as measured, a share (`reached`) as 100 or 0; None where it is absent or not a finite number."""
        if share := reached(self.metric):
            value = Objective(share[0]).measure(metrics)
            return None if value is None else 100.0 * (value >= share[1])
        value = value_at_path(metrics, self.metric)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return None
        return float(value)

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
            there = self.metric in dotted(metrics, of=object)
            return None, f"{'metric_not_a_number' if there else 'metric_missing'}: {self.metric}"
        return value, ""


def least_outcome(objective: Objective, limit: float) -> float:
    """Return a limit as an outcome, larger is better; that of a count lies half a one lower."""
    return objective.sign * limit - (0.5 if objective.metric in COUNTS else 0.0)


@dataclass(frozen=True)
class AskedObjective:
    """What such a text asks for."""

    objective: Objective
    second: Objective | None = None
    limit: float | None = None  # of the second: at most where less is better, at least where more is


def asked_objective(text: str, own: Mapping[str, Direction] | None = None) -> AskedObjective:
    """Return the meaning of a text; ``UserError`` in one line where it has none.

    ``own``: which way the metrics and costs of a mission file are better, as it says.
    """
    found = _FORM.fullmatch(re.sub(r"\s*(@|[<>]=|[()])\s*", r"\1", text.strip()))
    if found is None:
        raise UserError(
            f"objective {text!r} is not understood; write f_score, f_score@photographs<=21, photographs@f_score>=97 or "
            "photographs@P(f_score>=98)>=0.95"
        )
    first = _objective(found["first"], own)
    if found["second"] is None:
        return AskedObjective(first)
    second = _objective(found["second"], own)
    if first == second:
        raise UserError(f"objective {text!r} has the same metric twice; name a quality and a cost")
    right = "<=" if second.direction == "minimise" else ">="
    if found["sign"] != right:
        raise UserError(f"objective {text!r}: {second.metric} is {second.direction}d; write {right}")
    limit = _number(found["limit"], f"objective {text!r}")
    if second.is_share:
        require_share(limit, f"objective {text!r}")
        limit *= 100.0
    return AskedObjective(first, second, limit)


def require_share(share: float, what: str) -> None:
    """Raise `UserError` where a share that is asked for is not above 0 and below 1."""
    if not 0.0 < share < 1.0:
        raise UserError(
            f"{what}: a share is above 0 and below 1, not {share:g}; no number of rocks shows that all of them reach it: "
            "ask for 0.95"
        )


def objective_text(objective: Objective, second: Objective | None = None, limit: float | None = None) -> str:
    """Return the text that asks for them: the inverse of `asked_objective`."""
    text = _name(objective)
    if second is None:
        return text
    text += f"@{_name(second)}"
    if limit is not None and second.is_share:
        limit /= 100.0
    return text if limit is None else f"{text}{'<=' if second.direction == 'minimise' else '>='}{limit:g}"


def _name(objective: Objective) -> str:
    names = {path: name for name, path in SHORT.items()}
    if share := reached(objective.metric):
        return f"P({names.get(share[0], share[0])}>={share[1]:g})"
    return names.get(objective.metric, objective.metric)


def _objective(name: str, own: Mapping[str, Direction] | None) -> Objective:
    if "(" in name:
        if (share := _SHARE.fullmatch(name)) is None:
            raise UserError(f"{name!r} is not understood; the share of rocks that reach 98 is P(f_score>=98)")
        reaches = _objective(share["metric"], own)
        if reaches.direction != "maximise":
            raise UserError(
                f"{name!r}: less of {reaches.metric} is better; a share is of what should be at least so much"
            )
        return Objective(f"P({reaches.metric}>={_number(share['least'], name):g})")
    if own is not None:
        if (direction := own.get(name, "minimise" if name.startswith("costs.") else None)) is None:
            raise UserError(
                f"whether more or less of {name!r} is better is not known; say it in the mission file, such as "
                f"directions: {{{name}: maximise}}; costs are costs.NAME"
            )
        return Objective(name, direction)
    metric = SHORT.get(name, name)
    if metric.startswith("costs.") and metric not in COSTS:
        raise UserError(f"a mission has no cost {metric!r}; there are {', '.join(COSTS)}")
    return Objective(metric, direction_of(metric))


def _number(text: str, where: str) -> float:
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise UserError(f"{where}: {text!r} is not a number")
