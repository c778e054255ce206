"""Missions over rocks as a problem: a preset with overrides and the fixed values of a search space, under conditions."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nbv.cache import digest
from nbv.config import IDEAL, Condition, MissionConfig, under
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from tuner.campaign.rock_choice import procedural_rocks, rock_arguments
from tuner.missions.registry import DEFAULT_FIDELITY, code_of, kind_on
from tuner.problem.baselines import (
    ARMS,
    EVALUATION_BASELINES,
    RETARGETED_ORBITS,
    TUNED,
    TUNED_POOL_RANDOM,
    at_equal_number,
    baseline,
    baseline_configs,
    ending_at,
    is_orbit,
    orbits_at_number,
    photographs,
    reference_of,
    target_must_be_located,
    tuned_configs,
)
from tuner.problem.instances import Instance, are_drawn, held_out_rocks_of, instances_over, with_families
from tuner.problem.objective import COUNTS, Objective
from tuner.problem.observations import mission_key
from tuner.problem.problem import Evaluated, MissionProblem, Strategies
from tuner.problem.search_space import SearchSpace, Values, value_at

HIGHEST_DEG = 60.0
MOST_ENDS = 256


@dataclass(frozen=True, kw_only=True)
class RockProblem(MissionProblem):
    base: MissionConfig
    conditions: tuple[Condition, ...]
    fidelity_name: str  # the campaign's

    reference = "hyb-h"

    @staticmethod
    def of(
        space: SearchSpace,
        config: MissionConfig,
        rocks: Sequence[str],
        conditions: Sequence[Condition],
        fidelity: str,
        *,
        replicates: int,
        budget: int,
        seed: int,
    ) -> RockProblem:
        """Return the problem; ``config``: the preset with overrides and the fixed values of ``space``.

        Of a family every replicate is another rock: there are as many as the ``budget`` may need.

        Raises `UserError`: the space does not fit the preset; there is no such family; rocks beside families.
        """
        with_families(rocks)
        instances = instances_over(rocks, [condition.name for condition in conditions])
        if are_drawn(rocks):
            replicates = max(replicates, -(-budget // len(instances)))
        begin, space = space.begin, replace(space, begin=())
        default = space.default(config)
        base = space.config(config, default)
        problem = RockProblem(
            space=space,
            instances=instances,
            default=default,
            replicates=replicates,
            arms={**plain_plans(space, base), RockProblem.reference: default},
            base=base,
            seed=seed,
            conditions=tuple(conditions),
            fidelity_name=fidelity,
        )
        # Right when the file was read; what the campaign's settings exclude, such as a ring too low, is left out.
        begin = tuple(values for values in begin if problem.can_run({**default, **values}))
        return replace(problem, space=replace(space, begin=begin))

    @property
    def repeatable(self) -> tuple[Instance, ...]:
        """The sets of photographs."""
        return tuple(i for i in self.instances if kind_on(i.rock, self.fidelity_name).photographs == "taken")

    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> MissionConfig:
        """Return the configuration at ``values`` under one of the campaign's conditions, or none."""
        config = self.base.with_values(self.space.complete(values))
        named = {c.name: c for c in self.conditions}
        return config if condition == IDEAL else under(config, named[condition])

    def check_limit(self, limited: Objective, limit: float) -> None:
        """Raise `UserError` for fewer photographs than all missions take."""
        counted = limited.metric in COUNTS and limited.direction == "minimise"
        if counted and limit < (least := self._fewest_photographs()):
            raise UserError(
                f"the limit of {limit:g} photographs is below the {least} that every configuration here takes; raise it, "
                "or tune or --set the seed phase or stop.adaptive_budget"
            )

    def _fewest_photographs(self) -> int:
        """Return the least number at the ends of what is tuned of the seed phase and of the stopping rule."""
        tuned = [p for p in self.space.parameters if p.path.partition(".")[0] in ("seed", "stop")]
        counts = list[int]()
        for ends in itertools.islice(itertools.product(*(p.ends for p in tuned)), MOST_ENDS):
            with contextlib.suppress(UserError):  # ends that exclude one another
                config = self.config({**self.default, **{p.path: end for p, end in zip(tuned, ends)}})
                counts.append(config.seed.total if config.stop.may_end_early else photographs(config))
        return min(counts, default=0)

    def code(self) -> str:
        """Return the digest of the fidelity's code, and of the plug-ins of the default."""
        used = [plugin.facts for plugin in self.config(self.default).plugins_used]
        return digest(code_of(self.fidelity_name), used) if used else code_of(self.fidelity_name)

    def held_out(self) -> tuple[str, ...]:
        return tuple(procedural_rocks("held-out"))

    def evaluated_on(self, rocks: Sequence[str] | None, replicates: int) -> tuple[tuple[str, ...], int]:
        """Return rocks that can be loaded; of families their held-out rocks, one replicate each."""
        if not rocks and are_drawn(self.rocks):
            rocks = self.rocks
        if rocks and are_drawn(expanded := with_families(rocks)):  # a replicate of a family is another rock
            rocks, replicates = held_out_rocks_of(expanded, replicates), 1
        return tuple(rock_arguments(rocks or self.held_out())), replicates

    def strategies(self, tuned: Evaluated, names: Sequence[str] | None) -> Strategies:
        """Return the recommendation with the arms that split its gain, and baselines at its number of photographs."""
        counted = self._counted(tuned)
        if names is None:
            looking = target_must_be_located(self.base, _conditions_of_target(tuned))
            names = (*EVALUATION_BASELINES, *(RETARGETED_ORBITS if looking else ()))
        baselines = baseline_configs(list(names), self.base)
        equal = at_equal_number(baselines, counted, reference_of(baselines, self.reference))
        controls, notes = where_photographed(equal, tuned.rocks)
        arms = tuned_configs(self.config(tuned.values), self.base, counted)
        if not {"random", "hyb-h"} <= set(names):  # who names some strategies wants no others
            arms = {name: config for name, config in arms.items() if name in (TUNED, TUNED_POOL_RANDOM)}
        return Strategies({TUNED: arms.pop(TUNED), **controls, **arms}, notes)

    def controls(self, tuned: Evaluated) -> Strategies:
        """Return plain orbits at the recommendation's number of photographs."""
        return where_photographed(
            orbits_at_number(self._counted(tuned), _conditions_of_target(tuned)), tuned.rocks
        )

    def _counted(self, tuned: Evaluated) -> MissionConfig:
        """Return the configuration with the number of photographs that it takes: as measured, where something may end it."""
        config, number = self.config(tuned.values), tuned.photographs
        return config if number is None or not config.stop.may_end_early else ending_at(config, number)

    def can_run(self, values: Mapping[str, Any]) -> bool:
        try:
            self.config(values)
        except UserError:
            return False
        return True


def plain_plans(space: SearchSpace, base: MissionConfig, names: Sequence[str] = ARMS) -> dict[str, Values]:
    """Return the plain orbits and random views of these ``names`` that the space holds, all with the default's number."""
    plans = dict[str, Values]()
    for name in names:
        config = baseline(name).config(base)
        values = {path: value_at(config, path) for path in space.paths}
        if all(p.contains(values[p.path]) for p in space.parameters) and (
            mission_key(base.with_values(space.complete(values))) == mission_key(config)
        ):
            plans[name] = space.settled(values)
    return plans


def _conditions_of_target(tuned: Evaluated) -> Sequence[Condition]:
    """Return the conditions that may make the target's position uncertain: none over photographs that were taken before."""
    return () if _all_taken(tuned.rocks) else tuned.conditions


def _all_taken(rocks: Sequence[str]) -> bool:
    return bool(rocks) and all(kind_on(rock, DEFAULT_FIDELITY).photographs == "taken" for rock in rocks)


def where_photographed(strategies: Mapping[str, MissionConfig], rocks: Sequence[str]) -> Strategies:
    """Return ``strategies`` whose plain orbits run where the photographs are, if all ``rocks`` are sets, and a note that says so.

    One ring runs at the median elevation of all photographs, two rings at their quartiles.
    """
    if not _all_taken(rocks) or not any(map(is_orbit, strategies)):
        return Strategies(dict(strategies))
    elevations_deg = np.concatenate([PhotographSet.read(rock).coverage.elevations_deg for rock in rocks])
    low, middle, high = np.percentile(elevations_deg, [25, 50, 75]).clip(0.0, HIGHEST_DEG).round(1).tolist()

    def placed(config: MissionConfig) -> MissionConfig:
        one = config.seed.upper_share == 0
        ring = {"seed.lowest_deg": middle if one else low, "seed.span_deg": 0.0 if one else high - low}
        return config.with_values(ring)

    note = (
        f"Plain orbits run where the photographs were taken: one ring at {middle:g}° (the median), two at {low:g}° and "
        f"{high:g}° (the quartiles)."
    )
    runnable, orbits = dict[str, MissionConfig](), set[MissionConfig]()
    for name, config in strategies.items():
        if not is_orbit(name):
            runnable[name] = config
        elif (orbit := placed(config)) not in orbits:  # rings of several elevations are one there
            runnable[name] = orbit
            orbits.add(orbit)
    return Strategies(runnable, (note,))
