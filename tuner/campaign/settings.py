"""What a campaign was asked to do."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.config import (
    IDEAL_CONDITION,
    PRESETS,
    Condition,
    MissionConfig,
    condition_from_dict,
    load_conditions,
    preset,
    require_distinct,
)
from nbv.config.declaration import OneOrMore, Section, declared, setting
from nbv.errors import UserError
from nbv.mission.function import Keep
from tuner.campaign.rock_choice import procedural_rocks
from tuner.campaign.rock_problem import RockProblem
from tuner.campaign.shipped import NOTHING, SHIPPED, sources_by_default
from tuner.missions.external.mission_file import MissionFile, load_mission_file
from tuner.missions.external.problem import MissionFileProblem
from tuner.missions.registry import DEFAULT_FIDELITY, EXTERNAL, FIDELITIES
from tuner.problem.goal import Goal
from tuner.problem.instances import require_rocks
from tuner.problem.objective import DEFAULT_METRIC, Objective, direction_of
from tuner.problem.observations import MAX_MISSIONS, MAX_REPLICATES, Block, Proposal
from tuner.problem.problem import MissionProblem
from tuner.problem.search_space import SearchSpace
from tuner.problem.space_files import available_search_spaces, load_search_space, space_from_dict
from tuner.samplers.base import SamplerSettings
from tuner.samplers.design import initial_design_size
from tuner.samplers.registry import SAMPLERS

# Panels of the command's help.
WHAT, MISSION, SEARCH, WHERE = "What is tuned", "How missions run", "How long, how it searches", "Execution"
_DEFAULT_SPACE = "plan_and_gate"


def _read_space(raw: Any, source: str) -> SearchSpace:
    return load_search_space(raw) if isinstance(raw, str) else space_from_dict(raw, source)


def _read_conditions(raw: Any, source: str) -> tuple[Condition, ...]:
    if isinstance(raw, Mapping):
        return tuple(condition_from_dict(str(name), content, source) for name, content in raw.items())
    if not isinstance(raw, (list, tuple)) or any(not isinstance(name, str) for name in raw):
        raise UserError(
            f"{source}: conditions is {raw!r}; it must be a list of names and YAML files, or {{name: sections}}"
        )
    return load_conditions(raw)


def _read_objective(raw: Any, source: str) -> Objective:
    if not isinstance(raw, Mapping) or "metric" not in raw or not set(raw) <= {"metric", "direction"}:
        raise UserError(f"{source}: an objective is a metric's path or {{metric, direction}}, not {raw!r}")
    metric = str(raw["metric"])
    return Objective(metric, raw.get("direction") or direction_of(metric))


def _read_mission(raw: Any, source: str) -> MissionFile:
    if isinstance(raw, str):
        return load_mission_file(Path(raw))
    if not isinstance(raw, Mapping) or set(raw) != {"file", "sha256"}:
        raise UserError(f"{source}: mission is {raw!r}; it must be the path of a mission file")
    return load_mission_file(Path(str(raw["file"])), str(raw["sha256"]))


@dataclass(frozen=True, kw_only=True)
class CampaignSettings(Section):
    """What a campaign is; two campaigns with equal settings are the same experiment.

    Every setting is one field: command line, settings file, messages and the reference page are made from it.

    Raises
    ------
    UserError
        A budget, replicate count or rock list that makes no campaign; an unknown sampler or preset.
    """

    name: str = setting(
        "campaign", "the campaign's name; its directory is runs/NAME", option="--name", panel=WHAT
    )
    space: SearchSpace = setting(
        lambda: load_search_space(_DEFAULT_SPACE),
        "search space, a YAML file or a name",
        shown=_DEFAULT_SPACE,
        reason="it holds plain orbits, random views and the paper's configuration",
        names=available_search_spaces,
        option="--space",
        panel=WHAT,
        in_file="or the space itself, as in a search space's file",
        has_paths=True,
        builtin=True,
        read=_read_space,
        write=SearchSpace.to_dict,
    )
    rocks: tuple[str, ...] = setting(
        lambda: tuple(procedural_rocks("train")),
        "training rocks, names or mesh files; any-FAMILY (or any, for six families, any-shapes for five of no rocks) draws another rock for every mission, on "
        "which the default runs, too",
        shown="the procedural ones",
        option="--rock",
        panel=WHAT,
        has_paths=True,
    )
    conditions: tuple[Condition, ...] = setting(
        lambda: (IDEAL_CONDITION,),
        "conditions for every rock, names or YAML files",
        shown="ideal",
        option="--condition",
        panel=WHAT,
        in_file="or {name: sections}",
        has_paths=True,
        builtin=True,
        read=_read_conditions,
        write=lambda conditions: {condition.name: condition.to_dict() for condition in conditions},
    )
    compare_on: tuple[str, ...] = setting(
        tuple,
        "held-out rocks; after the search the recommendation, the paper's strategies and plain controls run on them and on "
        "the training rocks",
        shown="no comparison",
        option="--compare-on",
        panel=WHAT,
        has_paths=True,
        builtin=True,
    )
    mission: MissionFile | None = setting(
        None,
        "file of a mission of your own (see `gatetune mission init`), which has every setting not given here",
        option="--mission",
        panel=WHAT,
        has_paths=True,
        read=_read_mission,
        write=lambda mission: {"file": str(mission.path), "sha256": mission.sha256},
    )
    objective: Objective = setting(
        Objective,
        "what is tuned: a metric, seconds or energy; the best quality at a cost: f_score@photographs<=21; the least cost: "
        "photographs@f_score>=97",
        shown=DEFAULT_METRIC,
        option="--objective",
        panel=WHAT,
        in_file="or {metric, direction: maximise or minimise}",
        read=_read_objective,
        write=dataclasses.asdict,
    )
    second: Objective | None = setting(
        None,
        "a second objective",
        read=_read_objective,
        write=dataclasses.asdict,
    )
    limit: float | None = setting(
        None,
        "outcome constraint on the second objective: an upper bound if it is minimised, else a lower bound",
    )
    preset: str = setting(
        "campaign",
        "mission preset",
        names=lambda: PRESETS,
        option="--preset",
        panel=MISSION,
        builtin=True,
    )
    overrides: dict[str, Any] = setting(
        dict,
        "values by parameter path, laid over the preset in every mission",
        option="--set",
        panel=MISSION,
        builtin=True,
    )
    fidelity: str = setting(
        DEFAULT_FIDELITY,
        "how missions run: photogrammetric; geometric: without photographs, to rank configurations, not to measure; or a "
        "plug-in's",
        option="--fidelity",
        panel=MISSION,
        builtin=True,
    )
    replicates: OneOrMore = setting(
        2,
        "replicates per rock, which draw arrival errors and noise",
        limit=MAX_REPLICATES,
        option="--replicates",
        panel=MISSION,
    )
    budget: OneOrMore = setting(
        64,
        "length of the campaign",
        unit="missions",
        limit=MAX_MISSIONS,
        option="--budget",
        panel=SEARCH,
    )
    sampler: str = setting(
        "gp", "what proposes configurations", names=lambda: SAMPLERS, option="--sampler", panel=SEARCH
    )
    initial: OneOrMore | None = setting(
        None,
        "length of the initial design",
        shown="by sampler, budget and space",
        unit="missions",
    )
    learn_from: tuple[str, ...] | None = setting(
        None,
        f"earlier campaigns: run directories, {SHIPPED} (missions that come with this program) or {NOTHING}",
        shown=f"{SHIPPED} where the space has some",
        option="--learn-from",
        panel=SEARCH,
        has_paths=True,
    )
    seed: int = setting(0, "seed of the design and the acquisition", option="--seed", panel=SEARCH)
    keep: Keep = setting(
        "summary",
        "files kept of every mission (all: images and models, too)",
        option="--keep",
        panel=WHERE,
    )
    in_step: OneOrMore | None = setting(
        None,
        "N: each proposal uses all results except the latest N - 1 and waits for them, so that the campaign does not depend on "
        "the number of workers",
        shown="proposals do not wait",
        unit="missions",
    )

    def __repr__(self) -> str:
        """``CampaignSettings(mine: space gate, rocks slab, fin, 64 missions, sampler gp)``; `to_dict` has everything."""
        return (
            f"CampaignSettings({self.name}: space {self.space.name}, rocks {', '.join(self.rocks)}, {self.budget} missions, "
            f"sampler {self.sampler})"
        )

    def __post_init__(self) -> None:
        if not self.name:
            raise UserError("the campaign needs a name")
        super().__post_init__()
        if not 0 <= self.seed < 2**63:
            raise UserError(f"the seed is {self.seed}; give 0 or more, below 2**63")
        FIDELITIES.require(self.fidelity)
        require_rocks(self.rocks)
        require_distinct(self.conditions)
        if self.mission is None:  # a frozen record's one change of its own: bounds that the preset decides
            space = self.space.with_defaults(self.overrides).fitted(self._asked(self.space))
            object.__setattr__(self, "space", space)
        if twice := set(self.compare_on) & set(self.rocks):
            raise UserError(
                f"{sorted(twice)[0]} is tuned on and compared on; compare on rocks that the campaign does not tune on"
            )
        self._check_mission()
        self._check_options()
        self._check_conditions()
        self._check_limit()

    def _asked(self, space: SearchSpace) -> MissionConfig:
        """Return the preset with overrides and the fixed values of ``space``, at once: one may need the other."""
        return preset(self.preset).with_values({**self.overrides, **space.base})

    def _check_mission(self) -> None:
        if (self.fidelity == EXTERNAL) != (self.mission is not None):
            raise UserError(
                "the fidelity external and a mission file belong together; name one with --mission"
            )
        if self.mission is None:
            return
        for what, given in {
            "overrides": self.overrides,
            "conditions": self.conditions != (IDEAL_CONDITION,),
        }.items():
            if given:
                raise UserError(f"{what} apply to missions over rocks; leave them out with a mission file")
        if self.space != self.mission.space:
            raise UserError(f"the search space is that of {self.mission.path}; leave another one out")

    def _check_conditions(self) -> None:
        per_setting = {
            "overrides": self.overrides,
            "the search space": {**self.space.base, **dict.fromkeys(self.space.paths)},
        }
        for condition in self.conditions:
            for what, values in per_setting.items():
                for path in values:
                    if any(p == path or p.startswith(f"{path}.") for p in condition.paths):
                        raise UserError(
                            f"{path} is set by condition {condition.name!r} and by {what}; leave one of them out"
                        )
            self.problem.config(self.problem.default, condition.name)

    def _check_options(self) -> None:
        exclusive = {
            "a second objective": self.second is not None,
            "learning from earlier campaigns": bool(self.sources),
        }
        for what, wanted in exclusive.items():
            if wanted and self.sampler != "gp":
                raise UserError(f"{what} needs sampler gp, not {self.sampler}; leave it out or choose gp")
        if all(exclusive.values()):
            raise UserError(f"{' and '.join(exclusive)} cannot be combined; leave one of them out")

    def _check_limit(self) -> None:
        if (self.limit is None) != (self.second is None):
            missing = (
                "a second objective needs a limit"
                if self.limit is None
                else "a limit is of a second objective"
            )
            raise UserError(f"{missing}; write both as --objective f_score@photographs<=21")
        if self.limit is not None and self.second is not None:
            self.problem.check_limit(self.second, self.limit)

    @functools.cached_property
    def problem(self) -> MissionProblem:
        """What a trial is: a mission over rocks, or that of a mission file."""
        if self.mission is not None:
            return MissionFileProblem.of(self.mission, self.rocks, self.replicates)
        return RockProblem.of(
            self.space,
            self._asked(self.space),
            self.rocks,
            self.conditions,
            self.fidelity,
            replicates=self.replicates,
            budget=self.budget,
            seed=self.seed,
        )

    @functools.cached_property
    def goal(self) -> Goal:
        """What is good."""
        return Goal(self.objective, self.second, self.limit)

    @functools.cached_property
    def search(self) -> SamplerSettings:
        """What the sampler is made from, beside the missions of earlier campaigns."""
        return SamplerSettings(
            self.problem,
            self.seed,
            self.initial_size(),
            self.goal,
            budget=self.budget,
            arms=self._arms,
            trusted_default=self._trusted_default,
        )

    @property
    def _trusted_default(self) -> bool:
        """Whether half of the initial design stays near the default, whose values were chosen by hand.

        Not where the fewest photographs are sought: that is far away. Other samplers keep the designs their authors recommend.
        """
        return self.sampler == "gp" and self.goal.shown == self.objective

    @functools.cached_property
    def _arms(self) -> tuple[Proposal, ...]:
        """The missions that come first: every plain plan on the same blocks, block by block, the default before the others.

        Blocks are all replicates in every instance, as far as two thirds of the budget go; one where rocks are drawn and the
        default is the only plan: there it runs beside all that is proposed.
        """
        problem, reference = self.problem, self.problem.reference
        names = tuple(dict.fromkeys([reference, *problem.arms]))
        share = self.budget // 2 if len(names) == 1 else 2 * self.budget // 3
        if self.initial is not None:  # of an extended campaign; its design lies beyond that of the arms
            share = min(self.initial, share)
        count = max(1, min(len(problem.instances) * self.replicates, share // len(names)))
        if problem.draws_rocks and len(names) == 1:
            count = 1
        blocks = [(instance, k) for k in range(count) for instance in problem.instances][:count]

        def proposal(name: str, block: Block) -> Proposal:
            metadata = {"phase": "default" if name == reference else "arm", "arm": name}
            on = block if len(names) > 1 else (None, None)  # one alone takes blocks in turn
            return Proposal(dict(problem.arms[name]), metadata, *on)

        return tuple(proposal(name, block) for block in blocks for name in names)[: self.budget]

    def initial_size(self) -> int:
        """Missions of the initial design, those of the plain plans included."""
        if self.initial is not None:
            return min(self.initial, self.budget)
        behind_arms = len(self._arms) - 1
        return behind_arms + initial_design_size(
            self.space.dimension,
            self.budget,
            trusted_default=self._trusted_default,
            earlier=bool(self.sources),
        )

    @functools.cached_property
    def sources(self) -> tuple[str, ...]:
        """The campaigns that it learns from."""
        if self.learn_from is None:
            return sources_by_default(self.space, self.objective, self.sampler, self.second)
        if NOTHING in self.learn_from and len(self.learn_from) > 1:
            raise UserError(
                f"--learn-from {NOTHING} stands beside another --learn-from; leave one of them out"
            )
        return () if NOTHING in self.learn_from else self.learn_from

    def to_dict(self) -> dict[str, Any]:
        """Return the YAML form, as ``campaign.yaml`` has it; ``settings_file.settings_from_dict`` reads it back."""
        tree = {
            name: field.to_yaml(getattr(self, name)) for name, field in declared(CampaignSettings).items()
        }
        return {**tree, "initial": self.initial_size(), "learn_from": list(self.sources)}
