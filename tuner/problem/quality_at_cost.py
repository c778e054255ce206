"""Two objectives in one text: ``f_score@photographs<=21``.

- ``f_score``: one objective;
- ``f_score@photographs<=21``: the best quality at no more than so much of a cost;
- ``photographs@f_score>=97``: the least cost of a quality that is asked for.

A name is a metric's path, or one of `SHORT`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from nbv.errors import UserError
from tuner.problem.objective import DEFAULT_METRIC, Direction, Objective, direction_of

SHORT = {
    "f_score": DEFAULT_METRIC,
    "completeness": "observable.completeness_48mm",
    "photographs": "costs.images",
    "seconds": "costs.flight_time_s",
    "energy": "costs.energy_wh",
}
COUNTS = ("costs.images", "costs.registered_images")
COSTS = (*COUNTS, "costs.flight_time_s", "costs.path_length_m", "costs.energy_wh", "costs.wall_s")
_FORM = re.compile(
    r"(?P<first>[\w.]+)(\s*@\s*(?P<second>[\w.]+)\s*(?P<sign><=|>=)\s*(?P<limit>[-+.\deE]+))?", re.ASCII
)


@dataclass(frozen=True)
class AskedObjective:
    """What such a text asks for."""

    objective: Objective
    second: Objective | None = None
    limit: float | None = None  # of the second: at most where less is better, at least where more is


def asked_objective(text: str, own: Mapping[str, Direction] | None = None) -> AskedObjective:
    """The meaning of a text; ``UserError`` in one line where it has none.

    ``own``: which way metrics and costs of a mission that is not ours are better, as its mission file says.
    """
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise UserError(
            f"objective {text!r} is not understood; write f_score, f_score@photographs<=21 or "
            "photographs@f_score>=97"
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
    try:
        limit = float(found["limit"])
    except ValueError:
        limit = math.nan
    if not math.isfinite(limit):
        raise UserError(f"objective {text!r}: {found['limit']!r} is no number")
    return AskedObjective(first, second, limit)


def objective_text(objective: Objective, second: Objective | None = None, limit: float | None = None) -> str:
    """The text that asks for them: the inverse of `asked_objective`."""
    names = {path: name for name, path in SHORT.items()}
    text = names.get(objective.metric, objective.metric)
    if second is None:
        return text
    text += f"@{names.get(second.metric, second.metric)}"
    return text if limit is None else f"{text}{'<=' if second.direction == 'minimise' else '>='}{limit:g}"


def _objective(name: str, own: Mapping[str, Direction] | None) -> Objective:
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
