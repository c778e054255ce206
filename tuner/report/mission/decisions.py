"""What the gate of a mission decided at each step and why, from the mission's own trace."""

from __future__ import annotations

import collections
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.mission.result import IterationRecord, MissionResult
from nbv.scorers import COVIS
from tuner.evaluation.baselines import label as strategy_label
from tuner.report.mission.run_files import planned_config


@dataclass(frozen=True)
class Decision:
    """One step of the adaptive phase."""

    step: int  # from 1
    scorer: str  # whose ranking was flown
    why: str
    would_switch: str  # what of the gate's thresholds would have flown the other scorer; "" where it has none
    chosen: str  # candidate
    best: dict[str, dict[str, Any]]  # by scorer: its best candidate, the score and the terms

    def lines(self) -> list[str]:
        """The decision in words, three lines at most."""
        said = [f"step {self.step}: {self.scorer} chose {self.chosen}, since {self.why}"]
        others = [
            f"{name} would have chosen {'the same' if found['candidate'] == self.chosen else found['candidate']}"
            for name, found in self.best.items()
            if name != self.scorer
        ]
        scores = ", ".join(
            f"{name} {found['candidate']} {found['score']:.3f}" for name, found in self.best.items()
        )
        if others:
            said.append(f"  {'; '.join(others)} (best scores: {scores})")
        if self.would_switch:
            said.append(f"  {self.would_switch}")
        return said


def decisions_of(directory: Path) -> list[Decision]:
    """Every step of the mission in ``directory``.

    Raises
    ------
    UserError
        It holds no mission.
    """
    config = planned_config(directory)
    return [
        Decision(
            step=entry.iteration + 1,
            scorer=entry.scorer,
            why=_why(entry, config),
            would_switch=_would_switch(entry.gate_details, config),
            chosen=entry.chosen,
            best=entry.top,
        )
        for entry in MissionResult.load(directory).trace
        if entry.chosen
    ]


def gate_words(records: Sequence[IterationRecord], gate: str, missions: int) -> str:
    """Share of each scorer, of equal choices and of switches; or that it never switched."""
    n = len(records)
    counts = collections.Counter(record.scorer for record in records)
    views = [[best.get("candidate") for best in record.top.values()] for record in records]
    equal = sum(len(ids) > 1 and len(set(ids)) == 1 for ids in views)
    where = f"{n} views of {missions} {'mission' if missions == 1 else 'missions'}"
    same = f" In {_share(equal, n)} both scorers had the same best view." if equal else ""
    if len(counts) == 1:
        (scorer,) = counts
        return f"The gate ({gate}) never switched: {strategy_label(scorer)} chose all {where}.{same}"
    shares = ", ".join(f"{strategy_label(s)} {_share(c, n)}" for s, c in counts.most_common())
    following = [(a, b) for a, b in itertools.pairwise(records) if b.iteration == a.iteration + 1]
    switches = sum(a.scorer != b.scorer for a, b in following)
    return f"{gate} switched in {_share(switches, len(following))} of its steps: {shares} of {where}.{same}"


def _why(entry: IterationRecord, config: MissionConfig) -> str:
    """The reason; of Hyb-H in words with both thresholds."""
    details, gate = entry.gate_details, config.gate
    if "early" not in details:
        return str(entry.reason)
    used, d95_m = f"{100 * details['f_b']:.0f} % of the budget is used", details["d95_m"]
    share = f"{100 * gate.budget_fraction:.0f} %"
    cloud = "too few points to tell d95" if d95_m is None else f"d95 {1000 * d95_m:.0f} mm"
    limit = f"{1000 * gate.d95_m:.0f} mm"
    early = f"{used}, less than {share}" if details["early"] else f"{used}, no less than {share}"
    coarse = f"{cloud}, coarser than {limit}" if details["coarse"] else f"{cloud}, no coarser than {limit}"
    if details["early"] == details["coarse"]:
        return f"{early}, and the cloud has {coarse}"
    return early if details["early"] else f"the cloud has {coarse}"


def _would_switch(details: Mapping[str, Any], config: MissionConfig) -> str:
    """Of Hyb-H: the thresholds at which it would have flown the other scorer."""
    if "early" not in details:
        return ""
    early, coarse, d95_m = details["early"], details["coarse"], details["d95_m"]
    to = COVIS.name if early or coarse else config.gate.geometry_scorer
    if coarse and d95_m is None:
        return f"no threshold would have flown {to}: too few points count as coarse"
    if not early and not coarse:
        at = f"gate.budget_fraction above {_up(details['f_b'])}, or gate.d95_m below {_down(d95_m)}"
    else:
        needed = [f"gate.budget_fraction of at most {_down(details['f_b'])}"] if early else []
        needed += [f"gate.d95_m of at least {_up(d95_m)}"] if coarse else []
        at = " and ".join(needed)
    return f"{to} would have flown with {at}"


def _up(value: float) -> str:
    return f"{math.ceil(1e4 * value) / 1e4:g}"


def _down(value: float) -> str:
    return f"{math.floor(1e4 * value) / 1e4:g}"


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "0 %"
