"""What a trial of a campaign is: a preset with overrides and the fixed values of a search space, on a rock or a set of photographs."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nbv.cache import Store, digest
from nbv.config import IDEAL, Condition, MissionConfig, under
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from nbv.rocks import list_rocks, load_coarse_rock
from nbv.safe_files import is_file
from tuner.missions.registry import DEFAULT_FIDELITY, code_of, kind_on
from tuner.problem.baselines import (
    ARMS,
    EVALUATION_BASELINES,
    RECENTRED_ORBITS,
    ablations,
    at_equal_number,
    base_name,
    baseline,
    baseline_configs,
    ending_at,
    is_orbit,
    orbits_at_number,
    reference_of,
    target_must_be_located,
)
from tuner.problem.goal import COUNTS, Objective
from tuner.problem.instances import Instance, instances_over
from tuner.problem.observations import mission_key
from tuner.problem.search_space import PHOTOGRAPHS, SEEDS, Problem, SearchSpace, Values, regions_of, value_at

# Which rocks a command runs unless told otherwise, and which it may not.


def rock_arguments(rocks: Sequence[str], *, tuned: bool = False) -> list[str]:
    """Return the rocks as given, mesh files by their absolute path, so that a resume finds them from anywhere.

    Every rock is loaded once, as a coarse mesh, so that a mistake shows before the first mission.

    Raises `UserError`: an unknown rock or a bad mesh; a held-out rock where they are to be ``tuned`` on: nothing is
    tuned on these, and no default is chosen on them.
    """
    for rock in rocks:
        if load_coarse_rock(rock, Store()).split == "held-out" and tuned:
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )
    return absolute_rocks(rocks)


def absolute_rocks(rocks: Sequence[str]) -> list[str]:
    return [str(Path(rock).resolve()) if is_file(Path(rock)) else rock for rock in rocks]


def procedural_rocks(split: str) -> list[str]:
    """Return the procedural rocks of a split, ``train`` or ``held-out``, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == split and info.source == "procedural"]


HIGHEST_DEG = 60.0
MOST_ENDS = 256


class Strategies(NamedTuple):
    """What is run against each other, by name, and what a reader of the outcome must know of it."""

    configs: Mapping[str, MissionConfig]
    notes: tuple[str, ...] = ()


class Evaluated(NamedTuple):
    """The tuned configurations of a campaign, and what they are evaluated on."""

    tuned: Mapping[str, Mapping[str, Any]]  # values by name, such as ``tuned-planner``
    # That the last of them took, mean over its missions rounded up; None where it has none.
    photographs: int | None
    conditions: Sequence[Condition]
    rocks: Sequence[str]


@dataclass(frozen=True, kw_only=True)
class MissionProblem(Problem):
    """How a trial runs, and what it is compared with."""

    base: MissionConfig  # on which conditions and tuned values are laid
    conditions: tuple[Condition, ...]
    fidelity: str  # the campaign's

    reference = "hyb-h"  # the baseline that differences are from

    @staticmethod
    def of(
        space: SearchSpace,
        config: MissionConfig,
        rocks: Sequence[str],
        conditions: Sequence[Condition],
        fidelity: str,
        *,
        replicates: int,
        limited: bool,
    ) -> MissionProblem:
        """Return the problem; ``config``: the preset with overrides and the fixed values of ``space``.

        ``limited``: whether the goal has a limit. Raises `UserError`: the space does not fit the preset.
        """
        instances = instances_over(rocks, [condition.name for condition in conditions])
        begin, space = space.begin, replace(space, begin=())
        default = space.default(config)
        base = space.config(config, default)
        problem = MissionProblem(
            space=space,
            instances=instances,
            default=default,
            replicates=replicates,
            arms={**plain_plans(space, base), _name_of(base): default},
            regions=regions_of(space, default, limited=limited),
            base=base,
            conditions=tuple(conditions),
            fidelity=fidelity,
        )
        # Right when the file was read; what the campaign's settings exclude, such as a ring too low, is left out.
        begin = tuple(values for values in begin if problem.can_run(space.settled({**default, **values})))
        return replace(problem, space=replace(space, begin=begin))

    @property
    def repeatable(self) -> tuple[Instance, ...]:
        """The sets of photographs."""
        return tuple(i for i in self.instances if kind_on(i.rock, self.fidelity).photographs == "taken")

    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> MissionConfig:
        """Return the configuration at tuned ``values`` under one of the campaign's conditions, or none; `UserError` where there is none."""
        config = self.base.with_values(self.space.complete(values))
        named = {c.name: c for c in self.conditions}
        return config if condition == IDEAL else under(config, named[condition])

    def check_limit(self, limited: Objective, limit: float) -> None:
        """Raise `UserError` for fewer photographs than all missions take."""
        if limited.metric not in COUNTS or limited.direction != "minimise":
            return
        # The least number at the ends of what is tuned of the numbers and of the stopping rule.
        decide = (PHOTOGRAPHS, SEEDS, "stop.")
        tuned = [p for p in self.space.parameters if p.path.startswith(decide)]
        counts = list[int]()
        for ends in itertools.islice(itertools.product(*(p.ends for p in tuned)), MOST_ENDS):
            with contextlib.suppress(UserError):  # ends that exclude one another
                config = self.config({**self.default, **{p.path: end for p, end in zip(tuned, ends)}})
                counts.append(config.seeds if config.stop.may_end_early else config.photographs)
        if limit < (least := min(counts, default=0)):
            raise UserError(
                f"the limit of {limit:g} photographs is below the {least} that every configuration here takes; raise it, "
                "or tune or --set photographs"
            )

    def code(self) -> str:
        """Return the digest of the fidelity's code, and of the plug-ins of the default."""
        used = [plugin.facts for plugin in self.config(self.default).plugins_used]
        return digest(code_of(self.fidelity), used) if used else code_of(self.fidelity)

    def strategies(self, tuned: Evaluated, names: Sequence[str] | None) -> Strategies:
        """Return the tuned configurations and baselines at their number of photographs; unless the user ``names`` these, ablations, too."""
        configs = {name: self.config(values) for name, values in tuned.tuned.items()}
        counted = self._counted(tuned)
        split = (
            {}
            if names is not None
            else {k: v for n, c in configs.items() for k, v in ablations(n, c, self.base).items()}
        )
        if names is None:
            looking = target_must_be_located(self.base, _conditions_of_target(tuned))
            names = (*EVALUATION_BASELINES, *(RECENTRED_ORBITS if looking else ()))
        baselines = baseline_configs(list(names), self.base)
        equal = at_equal_number(baselines, counted, reference_of(baselines, self.reference))
        controls, notes = where_photographed(equal, tuned.rocks)
        return Strategies({**configs, **controls, **split}, notes)

    def controls(self, tuned: Evaluated) -> Strategies:
        """Return the tuned configurations, the default, and plain orbits at their number of photographs."""
        configs = {name: self.config(values) for name, values in tuned.tuned.items()}
        orbits = orbits_at_number(self._counted(tuned), _conditions_of_target(tuned))
        if self._counted(tuned).photographs == self.base.photographs:
            orbits = {base_name(name): config for name, config in orbits.items()}
        controls, notes = where_photographed(orbits, tuned.rocks)
        return Strategies({**configs, _name_of(self.base): self.config(self.default), **controls}, notes)

    def _counted(self, tuned: Evaluated) -> MissionConfig:
        """Return the last tuned configuration with the number of photographs that it takes: as measured, where something may end it."""
        config, number = self.config(list(tuned.tuned.values())[-1]), tuned.photographs
        return config if number is None or not config.stop.may_end_early else ending_at(config, number)

    def can_run(self, values: Mapping[str, Any]) -> bool:
        """Return whether there is a mission at ``values``."""
        try:
            self.config(values)
        except UserError:
            return False
        return True


def plain_plans(space: SearchSpace, base: MissionConfig) -> dict[str, Values]:
    """Return those of `ARMS` that the space holds, all with the default's number."""
    plans = dict[str, Values]()
    for name in ARMS:
        config = baseline(name).config(base)
        values = {path: value_at(config, path) for path in space.paths}
        if space.contains(values) and (
            mission_key(base.with_values(space.complete(values))) == mission_key(config)
        ):
            plans[name] = space.settled(values)
    return plans


def _name_of(base: MissionConfig) -> str:
    """Return the strategy that the default is: ``hyb-h`` where it flies the paper's seeds with the paper's gate."""
    paper = baseline(MissionProblem.reference).config(base)
    return MissionProblem.reference if mission_key(paper) == mission_key(base) else "default"


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
