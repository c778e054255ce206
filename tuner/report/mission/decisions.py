"""What the gate of a mission decided at each step and why, from the mission's own trace."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.mission.result import IterationRecord, MissionResult
from nbv.scorers import COVIS
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

    @property
    def same_choice(self) -> bool:
        """Whether all scorers would have flown the same candidate, so that the gate changed nothing."""
        return len({found["candidate"] for found in self.best.values()}) == 1

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {**vars(self), "same_choice": self.same_choice}

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
    config, trace = planned_config(directory), MissionResult.load(directory).trace
    return [
        Decision(
            step=entry.iteration + 1,
            scorer=entry.scorer,
            why=_why(entry, config),
            would_switch=_would_switch(entry.gate_details, config),
            chosen=entry.chosen,
            best=entry.top,
        )
        for entry in trace
        if entry.chosen
    ]


def summary(decisions: list[Decision], config: MissionConfig) -> str:
    """Which scorer flew how often, and how often that mattered."""
    if not decisions:
        return f"gate {config.gate.kind}: no step was planned"
    names = dict.fromkeys(d.scorer for d in decisions)
    flown = ", ".join(f"{name} {sum(d.scorer == name for d in decisions)}" for name in names)
    same = sum(d.same_choice for d in decisions)
    return (
        f"gate {config.gate.kind}, {len(decisions)} steps: {flown}; at {same} of them all scorers preferred the same "
        "candidate, so that the gate changed nothing there"
    )


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
