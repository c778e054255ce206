"""What is good: a metric, alone or under a limit of another, and the text that asks for it.

- ``f_score``: one objective;
- ``f_score@photographs<=21``: the best quality at no more than so much of a cost;
- ``photographs@f_score>=97``: the least cost of a quality that is asked for.

A name is a metric's path, or one of `SHORT`.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from nbv.errors import UserError
from tuner.problem.objective import COSTS, COUNTS, SHORT, Direction, Objective, direction_of
from tuner.problem.observations import Observation

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
    def quality(self) -> Objective | None:
        """The objective other than a count of photographs; None without one."""
        return next((o for o in self.objectives if o.metric not in COUNTS), None)

    @property
    def shown(self) -> Objective:
        """By what strategies are compared: the quality, or the objective where there is none."""
        return self.quality or self.objective

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


def parse_goal(text: str, directions: Mapping[str, Direction] | None = None) -> Goal:
    """Return the meaning of a text; ``UserError`` in one line where it has none.

    ``directions``: which way the metrics and costs of a mission file are better, as it says.
    """
    match = _FORM.fullmatch(re.sub(r"\s*(@|[<>]=)\s*", r"\1", text.strip()))
    if match is None:
        raise UserError(
            f"objective {text!r} is not understood; write f_score, f_score@photographs<=21 or photographs@f_score>=97"
        )
    first = _objective(match["first"], directions)
    if match["second"] is None:
        return Goal(first)
    second = _objective(match["second"], directions)
    if first == second:
        raise UserError(f"objective {text!r} has the same metric twice; name a quality and a cost")
    right = "<=" if second.direction == "minimise" else ">="
    if match["sign"] != right:
        raise UserError(f"objective {text!r}: {second.metric} is {second.direction}d; write {right}")
    return Goal(first, second, _number(match["limit"], f"objective {text!r}"))


def _name(objective: Objective) -> str:
    names = {path: name for name, path in SHORT.items()}
    return names.get(objective.metric, objective.metric)


def _objective(name: str, directions: Mapping[str, Direction] | None) -> Objective:
    if directions is not None:
        if (direction := directions.get(name, "minimise" if name.startswith("costs.") else None)) is None:
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
