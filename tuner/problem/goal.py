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
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from nbv.errors import UserError
from tuner.problem.objective import COSTS, COUNTS, PERCENTAGES, SHORT, Objective, direction_of
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
    limit, key = _number(match["limit"], f"objective {text!r}"), second.metric.rpartition(".")[2]
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


def _number(text: str, where: str) -> float:
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise UserError(f"{where}: {text!r} is not a number")
