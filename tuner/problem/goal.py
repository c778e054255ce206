"""What is good: a metric, alone or under a limit of another, and the text that asks for it.

- ``f_score``: one objective;
- ``f_score@photographs<=21``: the best quality at no more than so much of a cost;
- ``photographs@f_score>=97``: the least cost of a quality that is asked for.

A name is a metric's path, or one of `SHORT`.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from nbv.errors import UserError
from nbv.mission.result import value_at_path
from tuner.problem.observations import Observation

# One objective: a mission's metric, and which way it is better.


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


def by_dotted_path(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the leaves of a tree, such as a mission's metrics, by dotted path; names may be paths themselves."""
    leaves = dict[str, Any]()
    for name, value in tree.items():
        inner = isinstance(value, Mapping)
        leaves |= by_dotted_path(value, f"{prefix}{name}.") if inner else {f"{prefix}{name}": value}
    return leaves


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
            there = self.metric in by_dotted_path(metrics)
            return None, f"{'metric_not_a_number' if there else 'metric_missing'}: {self.metric}"
        return value, ""


# Of a text without blanks around its signs.
_FORM = re.compile(r"(?P<first>[\w.]+)(@(?P<second>[\w.]+)(?P<sign><=|>=)(?P<limit>[-+.\deE]+))?", re.ASCII)


@dataclass(frozen=True)
class Goal:
    """The objective, and the limit of a second one where there is one: only what keeps it may be recommended."""

    objective: Objective = field(default_factory=Objective)
    second: Objective | None = None
    # Of the second objective, in its unit: at most where less is better, at least where more is.
    limit: float | None = None

    @property
    def objectives(self) -> list[Objective]:
        return [self.objective] if self.second is None else [self.objective, self.second]

    @property
    def at_least(self) -> float | None:
        """The limit as an outcome of the second objective, larger is better; of a count what rounds to a number that keeps it does."""
        if self.second is None or self.limit is None:
            return None
        least = self.second.sign * self.limit
        return math.ceil(least) - 0.5 if self.second.metric in COUNTS else least

    @property
    def shown(self) -> Objective:
        """By what strategies are compared: the one that is no count of photographs, or the objective where all are."""
        return next((o for o in self.objectives if o.metric not in COUNTS), self.objective)

    def as_shown(self, history: Sequence[Observation]) -> list[Observation]:
        """Return the missions with their outcomes of `shown`."""
        return list(history) if self.shown is self.objective else with_second_first(history)

    def __str__(self) -> str:
        """The text that asks for it: the inverse of `parse_goal`."""
        text = _name(self.objective)
        if self.second is None or self.limit is None:
            return text
        return f"{text}@{_name(self.second)}{'<=' if self.second.direction == 'minimise' else '>='}{self.limit:g}"


def with_second_first(history: Sequence[Observation]) -> list[Observation]:
    """Return the missions that have both outcomes or failed, with those of the two objectives exchanged."""
    both = [o for o in history if o.outcome is None or o.second is not None]
    return [replace(o, outcome=o.second, second=o.outcome) for o in both]


def parse_goal(text: str) -> Goal:
    """Return the meaning of a text; ``UserError`` in one line where it has none."""
    match = _FORM.fullmatch(re.sub(r"\s*(@|[<>]=)\s*", r"\1", text.strip()))
    if match is None and (alone := re.fullmatch(r"([\w.]+)\s*([<>]=?)\s*(.+)", text.strip())):
        _objective(alone[1])  # a name that there is not
        raise UserError(
            f"objective {text!r} is a limit alone; write what is tuned before it: f_score@{alone[1]}{alone[2]}{alone[3]}"
        )
    if match is None:
        raise UserError(
            f"objective {text!r} is not understood; write f_score, f_score@photographs<=21 or photographs@f_score>=97"
        )
    first = _objective(match["first"])
    if match["second"] is None:
        return Goal(first)
    second = _objective(match["second"])
    if first == second:
        raise UserError(f"objective {text!r} has the same metric twice; name a quality and a cost")
    right = "<=" if second.direction == "minimise" else ">="
    if match["sign"] != right:
        raise UserError(f"objective {text!r}: {second.metric} is {second.direction}d; write {right}")
    limit, key = math.nan, second.metric.rpartition(".")[2]
    with contextlib.suppress(ValueError):
        limit = float(match["limit"])
    if not math.isfinite(limit):
        raise UserError(f"objective {text!r}: {match['limit']!r} is not a number")
    if key.startswith(PERCENTAGES) and not 0.0 < limit <= 100.0:
        raise UserError(
            f"objective {text!r}: {second.metric} is between 0 and 100 %, so nothing meets {limit:g}; ask for less"
        )
    return Goal(first, second, limit)


def _name(objective: Objective) -> str:
    names = {path: name for name, path in SHORT.items()}
    return names.get(objective.metric, objective.metric)


def _objective(name: str) -> Objective:
    metric = SHORT.get(name, name)
    if metric.startswith("costs.") and metric not in COSTS:
        raise UserError(f"a mission has no cost {metric!r}; there are {', '.join(COSTS)}")
    if "." not in metric and (close := difflib.get_close_matches(metric, SHORT, n=1)):
        raise UserError(f"there is no metric {metric!r}; did you mean {close[0]}?")
    return Objective(metric, direction_of(metric))
