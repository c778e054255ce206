"""The fixed strategies that a tuned configuration is compared with."""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass, field
from typing import Any

from nbv.config import GATES, MissionConfig
from nbv.errors import UserError


@dataclass(frozen=True)
class Baseline:
    """A strategy: which ranking the mission flies, everything else as in the base configuration."""

    name: str
    label: str
    description: str
    in_paper: bool = False
    values: dict[str, Any] = field(default_factory=dict)  # further parameters of the strategy

    @property
    def uses_ground_truth(self) -> bool:
        """Whether it is an upper reference, not deployable."""
        return self.name in GATES and bool(GATES.load(self.name).sees_ground_truth)

    def config(self, base: MissionConfig) -> MissionConfig:
        """``base`` flying this strategy."""
        return base.with_values({"gate.kind": self.name, **self.values})


BASELINES: dict[str, Baseline] = {
    b.name: b
    for b in (
        Baseline("covis", "Covis", "co-visibility scorer throughout (Eq. 5)", in_paper=True),
        Baseline("b-aware", "B-aware", "baseline-aware repair scorer throughout (Eq. 6 to 8)", in_paper=True),
        Baseline("hyb-h", "Hyb-H", "heuristic gate at the paper's thresholds (Eq. 9)", in_paper=True),
        Baseline("hyb-o", "Hyb-O", "oracle gate, from the true surface", in_paper=True),
        Baseline("learned", "Learned gate", "decision tree trained on the oracle's choices"),
        Baseline("random", "Random views", "a feasible candidate at random"),
        Baseline("novelty-only", "Novelty only", "the feasible candidate farthest from earlier views"),
        Baseline("movement-only", "Movement only", "the feasible candidate nearest to the vehicle"),
        Baseline("uniform-coverage", "Uniform coverage", "azimuths and elevations filled evenly"),
        # The ceiling needs the reward that the dense stage pays back: docs/results/oracle_coverage.md.
        Baseline(
            "greedy-oracle",
            "Greedy oracle",
            "each view chosen from the true surface",
            values={"gate.oracle_coverage": "matchable"},
        ),
        Baseline(
            "matchable",
            "Matchable",
            "our own scorer alone: the surface that lacks matchable views",
            values={f"matchable.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
        ),
    )
}
PAPER_STRATEGIES = tuple(name for name, b in BASELINES.items() if b.in_paper)
# What `gatetune evaluate` compares with unless told otherwise: the paper's four, the learned gate, our own scorer,
# and what chance and a planner that looks at the true surface reach.
EVALUATION_BASELINES = (*PAPER_STRATEGIES, "learned", "matchable", "random", "greedy-oracle")
# What `gatetune reproduce` flies: Table I's columns, and the same two references for the gates.
REPRODUCTION_STRATEGIES = (*PAPER_STRATEGIES, "learned", "greedy-oracle")
TUNED = "tuned"
# Chance in the pool that a tuned configuration plans in, where that is not the paper's: how much of the gain is
# the pool's. Not a baseline by name, since the pool is the campaign's result.
TUNED_POOL_RANDOM = "random-tuned-pool"


def baseline(name: str) -> Baseline:
    """The baseline called ``name``.

    Raises
    ------
    UserError
        There is none.
    """
    if name not in BASELINES:
        close = difflib.get_close_matches(name, BASELINES, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise UserError(f"unknown strategy {name!r}; {hint}there are {', '.join(BASELINES)}")
    return BASELINES[name]


def baseline_configs(names: tuple[str, ...] | list[str], base: MissionConfig) -> dict[str, MissionConfig]:
    """Configurations by strategy name, all from the same base."""
    return {name: baseline(name).config(base) for name in names}


def tuned_configs(tuned: MissionConfig, base: MissionConfig) -> dict[str, MissionConfig]:
    """The tuned configuration and, if it has changed the pool, random views in that pool."""
    configs = {TUNED: tuned}
    if tuned.pool != base.pool:
        configs[TUNED_POOL_RANDOM] = baseline("random").config(dataclasses.replace(base, pool=tuned.pool))
    return configs


def label(strategy: str) -> str:
    """What tables print for a strategy."""
    own = {TUNED: "Tuned", TUNED_POOL_RANDOM: "Random, tuned pool"}
    return own.get(strategy) or (BASELINES[strategy].label if strategy in BASELINES else strategy)


def description(strategy: str) -> str:
    """One line on what a strategy does."""
    own = {
        TUNED: "the recommended configuration",
        TUNED_POOL_RANDOM: "a candidate at random in the pool of the recommended configuration",
    }
    return own.get(strategy) or (BASELINES[strategy].description if strategy in BASELINES else "")
