"""What an evaluation runs: named configurations in the same instances with the same replicates, and its directory.

The directory holds ``evaluation.yaml`` and ``missions/STRATEGY/NN_ROCK_rK`` (``NN_ROCK_CONDITION_rK`` where that is not ideal).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import (
    IDEAL,
    IDEAL_CONDITION,
    Condition,
    MissionConfig,
    condition_from_dict,
    config_from_dict,
    require_distinct,
    under,
)
from nbv.errors import UserError
from nbv.mission.function import Keep
from nbv.safe_files import read_yaml, require
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.registry import DEFAULT_FIDELITY, FIDELITIES, kind_on
from tuner.problem.instances import Instance, require_rocks
from tuner.problem.observations import MAX_REPLICATES, mission_key

PLAN_FILE = "evaluation.yaml"
FORMAT_VERSION = 3


@dataclass(frozen=True)
class EvaluationPlan:
    """Named configurations, rocks, conditions and replicates; every combination is one mission.

    Raises `UserError`: nothing to compare.
    """

    strategies: Mapping[str, MissionConfig]
    rocks: tuple[str, ...]
    replicates: int = 1  # numbered from ``first_replicate``, the same for all strategies
    first_replicate: int = 0
    fidelity: str = DEFAULT_FIDELITY
    keep: Keep = "summary"
    conditions: tuple[Condition, ...] = (IDEAL_CONDITION,)

    def __post_init__(self) -> None:
        if not self.strategies:
            raise UserError("no strategy to evaluate; name at least one")
        require_rocks(self.rocks)
        require_distinct(self.conditions)
        FIDELITIES.require(self.fidelity)
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        require(self.replicates, MAX_REPLICATES, "replicates")
        for name in self.strategies:
            if not name or "/" in name or name.startswith("."):
                raise UserError(f"{name!r} cannot name a strategy; use letters, digits and dashes")

    @property
    def missions(self) -> int:
        """Missions in all, strategies that are the same configuration counted once."""
        return len(set(self.owners.values())) * len(self.instances) * self.replicates

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Every rock under every condition, condition by condition."""
        return tuple(Instance(rock, condition.name) for condition in self.conditions for rock in self.rocks)

    @property
    def combinations(self) -> int:
        """Strategies times instances times replicates: as many records has a complete evaluation."""
        return len(self.strategies) * len(self.instances) * self.replicates

    @property
    def _replicates(self) -> range:
        return range(self.first_replicate, self.first_replicate + self.replicates)

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT_VERSION,
            "rocks": list(self.rocks),
            "replicates": self.replicates,
            "first_replicate": self.first_replicate,
            "fidelity": self.fidelity,
            "keep": self.keep,
            "conditions": {condition.name: condition.to_dict() for condition in self.conditions},
            "strategies": {name: config.to_dict() for name, config in self.strategies.items()},
        }

    @staticmethod
    def load(directory: Path) -> EvaluationPlan:
        """The plan of an evaluation's directory; ``UserError`` if there is none."""
        path = directory / PLAN_FILE
        if not path.is_file():
            raise UserError(f"{directory} holds no evaluation ({PLAN_FILE} is missing)")
        try:
            tree = read_yaml(path)
            if tree["format"] != FORMAT_VERSION:
                raise UserError(
                    f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; begin it again in another directory"
                )
            return EvaluationPlan(
                {name: config_from_dict(config) for name, config in tree["strategies"].items()},
                tuple(tree["rocks"]),
                tree["replicates"],
                tree["first_replicate"],
                tree["fidelity"],
                tree["keep"],
                tuple(
                    condition_from_dict(name, content, str(path))
                    for name, content in tree["conditions"].items()
                ),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path} is not an evaluation's plan ({error!r}); restore the file") from error
        except UserError as error:  # such as a plug-in that is not installed
            raise UserError(f"{path}: {error}") from error

    def require_runnable(self) -> None:
        """Raise `UserError` where a strategy cannot fly under a condition, or a photograph set cannot give what it asks for."""
        for (name, config), condition in itertools.product(self.strategies.items(), self.conditions):
            try:
                varied = config if condition.name == IDEAL else under(config, condition)
                varied.require_flyable()
                for kind in (kind_on(rock, self.fidelity) for rock in self.rocks):
                    kind.require_possible(varied)
            except UserError as error:
                raise UserError(f"strategy {name} cannot run under {condition.name}: {error}") from error

    def jobs(self, directory: Path) -> list[MissionJob]:
        """One job per distinct mission: replicates outermost, so that partial results are balanced."""
        owners = dict.fromkeys(self.owners.values())
        return [
            self._job(directory, name, instance, k)
            for k, instance, name in itertools.product(self._replicates, self.instances, owners)
        ]

    @functools.cached_property
    def owners(self) -> dict[str, str]:
        """By strategy the one whose missions count for it: the first that runs the same."""
        first: dict[str, str] = {}
        return {name: first.setdefault(mission_key(c), name) for name, c in self.strategies.items()}

    def _job(self, directory: Path, strategy: str, instance: Instance, replicate: int) -> MissionJob:
        condition = next(c for c in self.conditions if c.name == instance.condition)
        owner = self.owners[strategy]
        config = self.strategies[owner]  # of the same mission, whatever else differs
        folder = f"{self.rocks.index(instance.rock):02d}_{instance.file_name}_r{replicate}"
        return MissionJob(
            f"{owner}/{folder}",
            config if condition.name == IDEAL else under(config, condition),
            instance.rock,
            replicate,
            directory / "missions" / owner / folder,
            self.keep,
            self.fidelity,
        )

    def records(self, directory: Path) -> list[Trial]:
        """What is known of every combination so far; missions not run yet are left out."""
        records = []
        for name, instance, k in itertools.product(self.strategies, self.instances, self._replicates):
            trial = load_trial(self._job(directory, name, instance, k))
            if trial is not None and not trial.infrastructure_failure:
                records.append(dataclasses.replace(trial, strategy=name))
        return records
