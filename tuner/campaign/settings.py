"""What a campaign was asked to do."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nbv.config import (
    IDEAL_CONDITION,
    PRESETS,
    Condition,
    condition_from_dict,
    load_conditions,
    preset,
    require_distinct,
)
from nbv.config.declaration import OneOrMore, Section, declared, setting
from nbv.errors import UserError
from nbv.mission.result import Keep
from tuner.campaign.mission_problem import MissionProblem, procedural_rocks
from tuner.missions.registry import DEFAULT_FIDELITY, FIDELITIES
from tuner.problem.goal import DEFAULT_METRIC, Goal, Objective, direction_of
from tuner.problem.instances import require_rocks
from tuner.problem.observations import MAX_MISSIONS, MAX_REPLICATES, Block, Proposal
from tuner.problem.search_space import SearchSpace
from tuner.problem.space_files import available_search_spaces, load_search_space, space_from_dict
from tuner.samplers.base import SAMPLERS, SamplerSettings, initial_design_size

# Panels of the command's help.
WHAT, MISSION, SEARCH, WHERE = "What is tuned", "How missions run", "How long, how it searches", "Execution"
_DEFAULT_SPACE = "plan_and_gate"


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
        read=lambda raw, source: (
            load_search_space(raw) if isinstance(raw, str) else space_from_dict(raw, source)
        ),
        write=SearchSpace.to_dict,
    )
    rocks: tuple[str, ...] = setting(
        lambda: tuple(procedural_rocks("train")),
        "training rocks, names or mesh files",
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
    )
    overrides: dict[str, Any] = setting(
        dict,
        "values by parameter path, laid over the preset in every mission",
        option="--set",
        panel=MISSION,
    )
    fidelity: str = setting(
        DEFAULT_FIDELITY,
        "how missions run: photogrammetric; geometric: without photographs, to rank configurations, not to measure; or a "
        "plug-in's",
        option="--fidelity",
        panel=MISSION,
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
        "length of the search; up to a tenth more flies its favourites again",
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
    learn_from: tuple[str, ...] = setting(
        tuple,
        "run directories of earlier campaigns, whose missions say what to try first",
        shown="none",
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
        # A frozen record's one change of its own: bounds that the preset decides.
        space = self.space.with_defaults(self.overrides)
        space = space.fitted(space.base_config(preset(self.preset), self.overrides))
        object.__setattr__(self, "space", space)
        if twice := set(self.compare_on) & set(self.rocks):
            raise UserError(
                f"{sorted(twice)[0]} is tuned on and compared on; compare on rocks that the campaign does not tune on"
            )
        self._check_options()
        self._check_conditions()
        self._check_limit()

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
            "learning from earlier campaigns": bool(self.learn_from),
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
        """What a trial is."""
        return MissionProblem.of(
            self.space,
            self.space.base_config(preset(self.preset), self.overrides),
            self.rocks,
            self.conditions,
            self.fidelity,
            replicates=self.replicates,
            limited=self.limit is not None,
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
        """The missions that come first: the default, then each baseline, on the same blocks.

        Blocks are all instances with one replicate, then with the next, as far as a quarter of the budget goes. Workers are on
        different targets so: of one target each makes again what the other is making.
        """
        problem = self.problem
        (default,) = (name for name, values in problem.arms.items() if values == problem.default)
        names = tuple(dict.fromkeys([default, *problem.arms]))
        share = self.budget // 4
        if self.initial is not None:  # of an extended campaign; its design lies beyond that of the arms
            share = min(self.initial, share)
        count, once = (
            max(1, min(len(problem.instances) * self.replicates, share // len(names))),
            len(problem.instances),
        )
        count -= count % once if count > once else 0  # as many in every instance
        blocks = [(instance, k) for k in range(count) for instance in problem.instances][:count]

        def proposal(name: str, block: Block) -> Proposal:
            metadata = {"phase": "default" if name == default else "arm", "arm": name}
            on = block if len(names) > 1 else (None, None)  # one alone takes blocks in turn
            return Proposal(dict(problem.arms[name]), metadata, *on)

        return tuple(proposal(name, block) for name in names for block in blocks)[: self.budget]

    def initial_size(self) -> int:
        """Missions of the initial design, those of the plain plans included."""
        if self.initial is not None:
            return min(self.initial, self.budget)
        behind_arms = len(self._arms) - 1
        return behind_arms + initial_design_size(
            self.space.dimension,
            self.budget,
            trusted_default=self._trusted_default,
            earlier=bool(self.learn_from),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the YAML form, as ``campaign.yaml`` has it; ``settings_file.settings_from_dict`` reads it back."""
        tree = {
            name: field.to_yaml(getattr(self, name)) for name, field in declared(CampaignSettings).items()
        }
        return {**tree, "initial": self.initial_size()}
