"""Does what was tuned in one world hold in another?

The tuned configuration of a campaign, its neighbours in the search space and the baselines are flown in every world on
the same rocks and replicates. The run directory::

    transfer.yaml   what was asked for; the same command with the same settings goes on
    WORLD/          an evaluation's directory each
    transfer.json  transfer.csv  report.md  gains.png  worlds.png
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from nbv.config import Condition, MissionConfig, config_from_dict
from nbv.errors import UserError
from nbv.mission.result import json_ready
from research.decisions import by_rock
from research.study_directory import StudyFindings, StudySettings, counts, evaluated
from research.transfer.agreement import Agreement, Outcomes, agreement, self_agreement
from research.transfer.worlds import World
from tuner.evaluation.baselines import (
    BASELINES,
    EVALUATION_BASELINES,
    TUNED,
    TUNED_POOL_RANDOM,
    baseline_configs,
    tuned_configs,
)
from tuner.evaluation.comparison import (
    Interval,
    PairedDifference,
    mean_interval,
    paired_difference,
    values_of,
)
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.job import Trial
from tuner.problem.objective import Objective
from tuner.problem.search_space import builtin, value_at

if TYPE_CHECKING:
    from pathlib import Path

    from tuner.campaign.campaign import Campaign

REFERENCE, RANDOM = "hyb-h", "random"
NEIGHBOUR_SD = (
    0.15  # of the unit cube in every coordinate: near enough to be alike, far enough to be told apart
)
_MAX_TRIES = 100


@dataclass(frozen=True)
class TransferSettings(StudySettings):
    """What the study flies.

    Raises
    ------
    UserError
        No world, or a plan that makes no evaluation.
    """

    FILE: ClassVar[str] = "transfer.yaml"
    STUDY: ClassVar[str] = "study of transfer"
    campaign: str  # name of the one whose configuration is carried over
    worlds: dict[str, World]
    configurations: dict[str, MissionConfig]
    rocks: tuple[str, ...]
    replicates: int = 2
    metric: str = Objective.metric
    direction: str = Objective.direction

    def __post_init__(self) -> None:
        if not self.worlds:
            raise UserError("no world to fly in; name at least one")
        self.plans()

    @property
    def random(self) -> str:
        """Chance in the pool that the tuned configuration plans in."""
        return TUNED_POOL_RANDOM if TUNED_POOL_RANDOM in self.configurations else RANDOM

    @property
    def ranked(self) -> list[str]:
        """Configurations that a vehicle could fly: those that look at the true surface are not chosen among."""
        return [n for n in self.configurations if n not in BASELINES or not BASELINES[n].uses_ground_truth]

    def plans(self) -> dict[str, EvaluationPlan]:
        """One evaluation per world."""
        return {
            name: EvaluationPlan(
                dict(self.configurations),
                self.rocks,
                self.replicates,
                fidelity=world.fidelity,
                conditions=(world.condition,),
            )
            for name, world in self.worlds.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        return {
            **super().to_dict(),
            "worlds": {name: json_ready(dataclasses.asdict(world)) for name, world in self.worlds.items()},
            "configurations": {name: config.to_dict() for name, config in self.configurations.items()},
        }

    @classmethod
    def from_dict(cls, tree: dict[str, Any], source: str) -> Self:
        """The inverse of ``to_dict``."""
        worlds = {
            name: World(**{**world, "condition": Condition(**world["condition"])})
            for name, world in tree["worlds"].items()
        }
        configurations = {name: config_from_dict(config) for name, config in tree["configurations"].items()}
        return super().from_dict({**tree, "worlds": worlds, "configurations": configurations}, source)


def carried_over(campaign: Campaign, neighbours: int, seed: int = 0) -> dict[str, MissionConfig]:
    """The campaign's tuned configuration, ``neighbours`` drawn around it, and the baselines, by name.

    Raises
    ------
    UserError
        No mission of the campaign has succeeded, or its space has fewer neighbours.
    """
    if neighbours < 0:
        raise UserError(f"--neighbours is {neighbours}; give 0 or more")
    base = builtin(campaign.settings.base_config())
    tuned = builtin(campaign.recommended_config())
    around = _neighbours(campaign, tuned, neighbours, seed)
    named = {f"neighbour-{i + 1}": config for i, config in enumerate(around)}
    tuned_and_random = tuned_configs(tuned, base)
    return {TUNED: tuned, **named, **tuned_and_random, **baseline_configs(EVALUATION_BASELINES, base)}


def _neighbours(campaign: Campaign, tuned: MissionConfig, count: int, seed: int) -> list[MissionConfig]:
    """Distinct configurations, normally distributed around ``tuned`` in the unit cube of the campaign's space."""
    space = campaign.settings.space
    center = space.to_unit({path: value_at(tuned, path) for path in space.paths})
    rng = np.random.default_rng(seed)
    found = {tuned.digest(): tuned}
    for _ in range(_MAX_TRIES * count):
        if len(found) > count:
            break
        moved = np.clip(center + NEIGHBOUR_SD * rng.standard_normal(space.dimension), 0.0, 1.0)
        values = space.from_unit(space.redraw_choices(moved, center, rng))
        config = builtin(campaign.settings.config(values))
        found.setdefault(config.digest(), config)
    else:
        if len(found) <= count:
            raise UserError(
                f"space {space.name!r} has fewer than {count} neighbours of the tuned configuration; ask for fewer"
            )
    return list(found.values())[1:]


# -- what the missions say -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ConfigurationResult:
    """One configuration in one world."""

    name: str
    missions: int  # with metrics
    failed: int
    mean: Interval | None
    difference: PairedDifference | None  # minus Hyb-H; None for itself


@dataclass(frozen=True)
class WorldResult:
    """One world."""

    name: str
    configurations: list[ConfigurationResult]
    best: str  # by its mean, of those that a vehicle could fly; empty without missions
    tuned_minus_random: PairedDifference | None  # chance in the tuned configuration's pool
    self_agreement: float | None

    def configuration(self, name: str) -> ConfigurationResult:
        """The configuration of that name."""
        return next(c for c in self.configurations if c.name == name)


@dataclass(frozen=True)
class TransferFindings(StudyFindings[TransferSettings]):
    """All worlds, and all ordered pairs of them."""

    worlds: list[WorldResult]
    pairs: dict[tuple[str, str], Agreement]  # (chosen in, flown in)

    def to_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            **super().to_dict(),
            "worlds": [dataclasses.asdict(world) for world in self.worlds],
            "pairs": [
                {"chosen_in": a, "flown_in": b, **dataclasses.asdict(pair)}
                for (a, b), pair in self.pairs.items()
            ],
        }


def analyse(directory: Path) -> TransferFindings:
    """What the missions of a study's directory say so far.

    Raises
    ------
    UserError
        The directory holds no such study.
    """
    settings = TransferSettings.load(directory)
    objective = Objective(settings.metric, "minimise" if settings.direction == "minimise" else "maximise")
    found = evaluated(settings, directory)
    oriented: dict[str, Outcomes] = {
        name: {
            c: {block: objective.sign * y for block, y in values_of(records, c, settings.metric).items()}
            for c in settings.ranked
        }
        for name, records in found.items()
    }
    return TransferFindings(
        settings,
        *counts(settings, list(itertools.chain.from_iterable(found.values()))),
        [_world(settings, name, records, oriented[name]) for name, records in found.items()],
        {(a, b): agreement(oriented[a], oriented[b]) for a, b in itertools.permutations(found, 2)},
    )


def _world(
    settings: TransferSettings, name: str, records: Sequence[Trial], oriented: Outcomes
) -> WorldResult:
    higher = settings.direction == "maximise"
    values = {c: values_of(records, c, settings.metric) for c in settings.configurations}
    results = [
        ConfigurationResult(
            c,
            len(own),
            sum(r.strategy == c and r.status == "failed" for r in records),
            mean_interval(by_rock(own)),
            None if c == REFERENCE else paired_difference(own, values[REFERENCE], higher),
        )
        for c, own in values.items()
    ]
    return WorldResult(
        name,
        results,
        agreement(oriented, oriented).best,
        paired_difference(values[TUNED], values[settings.random], higher),
        self_agreement(oriented),
    )
