"""Which parameters of a configuration changed no choice in the missions that flew it.

The weights of a scorer that chose no view say nothing, whatever the numbers are. Nor do thresholds of a gate that never
switched, beyond the range in which it does not. A mission records every choice with what the gate compared, so this is
known of the missions flown, not believed. Only of Hyb-H and of single scorers: other gates read every ranking.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nbv.config import SCORERS, GateConfig, MissionConfig
from nbv.mission.result import IterationRecord
from tuner.problem.search_space import Configuration, SearchSpace

HYB_H = "hyb-h"
_SCORER_OF_SECTION = {name.replace("-", "_"): name for name in SCORERS}
# A condition of Eq. 9 each: the threshold, and whether smaller values fly the geometry scorer.
_CONDITIONS = (("gate.d95_m", False), ("gate.budget_fraction", True))


@dataclass(frozen=True)
class Inactive:
    """A parameter whose number says nothing, at one configuration."""

    path: str
    why: str  # "covis chose none of 480 views"
    default_is_the_same: bool  # every choice flown would have been the same with the default value


def inactive_parameters(
    space: SearchSpace,
    config: Configuration,
    default: Mapping[str, Any],
    traces: Sequence[Sequence[IterationRecord]],
) -> list[Inactive]:
    """Return the parameters whose numbers changed no choice, in the space's order; empty where nothing is known.

    Those whose ``default_is_the_same`` may go back to the default values together.

    Parameters
    ----------
    space
        The search space.
    config
        The configuration that was flown.
    default
        The default values.
    traces
        One trace for each mission that flew ``config``.
    """
    records = [record for trace in traces for record in trace]
    if not records or not isinstance(config, MissionConfig) or config.gate.kind not in (HYB_H, *SCORERS):
        return []
    flown = {record.scorer for record in records}
    found = {}
    for parameter in space.parameters:
        sections = {path.partition(".")[0] for path in (parameter.path, *parameter.also)}
        owners = {_SCORER_OF_SECTION.get(section, "") for section in sections}
        if parameter.path == "gate.geometry_scorer" and config.gate.kind == HYB_H:
            owners = {config.gate.geometry_scorer}
        if "" not in owners and not owners & flown:
            why = f"{' and '.join(sorted(owners))} chose none of {len(records)} views"
            found[parameter.path] = Inactive(parameter.path, why, True)
    if config.gate.kind == HYB_H:
        found |= _thresholds(space, config.gate, default, records)
    return [found[path] for path in space.paths if path in found]


def _thresholds(
    space: SearchSpace, gate: GateConfig, default: Mapping[str, Any], records: Sequence[IterationRecord]
) -> dict[str, Inactive]:
    if any("f_b" not in record.gate_details for record in records):
        return {}  # missions of before this was recorded
    scorers = sorted({record.scorer for record in records})
    never = (
        f"the gate never switched: {scorers[0]} chose all {len(records)} views; " if len(scorers) == 1 else ""
    )
    found = {}
    for path, below in _CONDITIONS:
        if path not in space.paths:
            continue
        low, high = _same_choices(gate, records, below)
        same = low <= float(default[path]) < high if not below else low < float(default[path]) <= high
        if never or same:
            why = f"{never}{_range_text(low, high)} makes the same choices"
            found[path] = Inactive(path, why, same)
        if same:  # the next threshold has to have no effect beside this default
            gate = replace(gate, **{path.partition(".")[2]: default[path]})
    return found


def _same_choices(gate: GateConfig, records: Sequence[IterationRecord], below: bool) -> tuple[float, float]:
    """The values of one threshold with which Hyb-H makes the choices that it made, the other as in ``gate``."""
    low, high = -math.inf, math.inf
    for record in records:
        f_b = float(record.gate_details["f_b"])
        d95_m = record.gate_details["d95_m"]
        d95_m = math.inf if d95_m is None else float(d95_m)  # null in JSON: too few points to tell
        value, other = (f_b, d95_m > gate.d95_m) if below else (d95_m, f_b < gate.budget_fraction)
        if other:
            continue
        repaired = value < gate.budget_fraction if below else value > gate.d95_m
        if repaired == below:
            low = max(low, value)
        else:
            high = min(high, value)
    return low, high


def _range_text(low: float, high: float) -> str:
    if low == -math.inf and high == math.inf:
        return "any value"
    if high == math.inf:
        return f"any value above {low:.3g}"
    return f"any value below {high:.3g}" if low == -math.inf else f"any value from {low:.3g} to {high:.3g}"
