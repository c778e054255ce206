"""The fixed strategies that a tuned configuration is compared with."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from nbv.config import GATES, MissionConfig
from nbv.errors import UserError
from tuner.problem.search_space import Configuration


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


def at_equal_number(
    configs: dict[str, MissionConfig], tuned: MissionConfig, reference: str
) -> dict[str, MissionConfig]:
    """The baselines with the seeds and planned views of ``tuned``, and ``reference`` at its own number beside them.

    Names say the number, as in ``hyb-h-26``; where the number is the same anyway, ``configs`` as they are.
    """
    number = photographs(tuned)
    if all(config.seed == tuned.seed and photographs(config) == number for config in configs.values()):
        return configs
    equal = {
        f"{name}-{number}": dataclasses.replace(
            config,
            seed=tuned.seed,
            sparse=tuned.sparse,  # what seeds far apart need to register
            stop=dataclasses.replace(
                config.stop,
                adaptive_budget=tuned.stop.adaptive_budget,
                max_photographs=tuned.stop.max_photographs,
            ),
        )
        for name, config in configs.items()
    }
    return {reference: configs[reference], **equal}


def photographs(config: MissionConfig) -> int:
    """Seeds and planned views of a mission that nothing ends early."""
    return config.seed.total + config.adaptive_budget


def controls_at_equal_number(strategies: Mapping[str, Configuration]) -> tuple[str, ...]:
    """Those that fly as many photographs as the tuned one, are not its equal, and see nothing of the true surface."""
    tuned = strategies.get(TUNED)
    if not isinstance(tuned, MissionConfig):
        return ()
    return tuple(
        name
        for name, config in strategies.items()
        if isinstance(config, MissionConfig)
        and photographs(config) == photographs(tuned)
        and config.digest() != tuned.digest()
        and not sees_ground_truth(name)
    )


def _split(strategy: str) -> tuple[str, str]:
    """``hyb-h`` and ``26`` of ``hyb-h-26``; the number is empty where there is none."""
    name, _, number = strategy.rpartition("-")
    return (name, number) if number.isdigit() and name in BASELINES else (strategy, "")


def tuned_configs(tuned: MissionConfig, base: MissionConfig) -> dict[str, MissionConfig]:
    """The tuned configuration and, if it has changed the pool, random views in that pool."""
    configs = {TUNED: tuned}
    if tuned.pool != base.pool:
        chance = baseline("random").config(dataclasses.replace(base, pool=tuned.pool))
        (configs[TUNED_POOL_RANDOM],) = list(at_equal_number({"random": chance}, tuned, "random").values())[
            -1:
        ]
    return configs


def label(strategy: str) -> str:
    """What tables print for a strategy."""
    own = {TUNED: "Tuned", TUNED_POOL_RANDOM: "Random, tuned pool"}
    name, number = _split(strategy)
    known = BASELINES[name].label if name in BASELINES else strategy
    return own.get(strategy) or (f"{known}, {number}" if number else known)


def description(strategy: str) -> str:
    """One line on what a strategy does."""
    own = {
        TUNED: "the recommended configuration",
        TUNED_POOL_RANDOM: "a candidate at random in the pool of the recommended configuration",
    }
    name, number = _split(strategy)
    known = BASELINES[name].description if name in BASELINES else ""
    return own.get(strategy) or (f"{known}; {number} photographs, as tuned" if number else known)


def sees_ground_truth(strategy: str) -> bool:
    """Whether a strategy is an upper reference, not deployable."""
    name, _ = _split(strategy)
    return name in BASELINES and BASELINES[name].uses_ground_truth
