"""What a campaign was asked to do."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from nbv.config import IDEAL, IDEAL_CONDITION, Condition, MissionConfig, preset, require_distinct, under
from nbv.errors import UserError
from nbv.mission.function import Keep
from nbv.safe_files import require
from tuner.missions.external import MissionFile, external_config
from tuner.missions.registry import DEFAULT_FIDELITY, EXTERNAL, require_fidelity
from tuner.problem.blocks import MAX_MISSIONS, MAX_REPLICATES
from tuner.problem.exact_costs import Exact, exact_cost
from tuner.problem.objective import Objective
from tuner.problem.options import RISKS, Risk
from tuner.problem.quality_at_cost import COUNTS
from tuner.problem.search_space import Configuration, SearchSpace, Values, ours
from tuner.problem.secrets import require_no_password
from tuner.problem.worlds import World, worlds_over
from tuner.samplers.design import initial_design_size
from tuner.samplers.registry import SAMPLER_NAMES


@dataclass(frozen=True)
class CampaignSettings:
    """What a campaign is; two campaigns with equal settings are the same experiment.

    Raises
    ------
    UserError
        A budget, replicate count or rock list that makes no campaign; an unknown sampler or preset.
    """

    name: str
    space: SearchSpace
    rocks: tuple[str, ...]  # training rocks: names or mesh files
    budget: int  # missions
    replicates: int = 1  # per rock, numbered from 0
    seed: int = 0
    preset: str = "campaign"
    overrides: dict[str, Any] = field(default_factory=dict)  # parameter paths laid over the preset
    objective: Objective = field(default_factory=Objective)
    sampler: str = "gp"
    initial: int | None = None  # missions of the initial design; None: as many as suit sampler and budget
    fidelity: str = DEFAULT_FIDELITY  # a name of tuner.missions.registry, or module:function
    keep: Keep = "summary"
    storage: str | None = None  # None: study.journal in the run directory
    risk: Risk = "mean"  # over the training worlds: tune their mean, or the worst of them
    second: Objective | None = None  # search the front between the objective and this one
    limit: float | None = None  # of the second objective: the best within it, instead of the front
    learn_from: tuple[str, ...] = ()  # run directories of earlier campaigns, see tuner.campaign.transfer
    # A proposal knows every earlier mission but the last in_step - 1, whichever of those have ended: the same campaign
    # with any number of workers (of which in_step have work). None: it knows what has ended, so that nobody waits.
    in_step: int | None = None
    conditions: tuple[Condition, ...] = (IDEAL_CONDITION,)  # every rock is flown under each
    mission: MissionFile | None = (
        None  # a mission that is not ours: its space, its instances as rocks, its metric
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
        if self.budget < 1:
            raise UserError(f"the budget is {self.budget} missions; give at least 1")
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        require(self.budget, MAX_MISSIONS, "the budget in missions")
        require(self.replicates, MAX_REPLICATES, "replicates")
        if self.in_step is not None and self.in_step < 1:
            raise UserError(f"in step is {self.in_step} missions; give at least 1")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"the seed is {self.seed}; give 0 or more, below 2**63")
        if not self.rocks:
            raise UserError("the campaign has no rocks; name at least one")
        require_distinct(self.conditions)
        twice = [rock for rock, count in collections.Counter(self.rocks).items() if count > 1]
        if twice:
            raise UserError(f"rock {twice[0]!r} is named twice; name each rock once")
        if self.initial is not None and self.initial < 1:
            raise UserError(f"the initial design has {self.initial} missions; give at least 1")
        if self.keep not in ("summary", "all"):
            raise UserError(f"keep is {self.keep!r}; it must be summary or all")
        require_fidelity(self.fidelity)
        require_no_password(self.storage)
        self._check_mission()
        self._check_options()
        if self.sampler not in SAMPLER_NAMES:
            raise UserError(f"unknown sampler {self.sampler!r}; there are {', '.join(SAMPLER_NAMES)}")
        self.default_values()  # the space must fit the preset
        self._check_conditions()
        self._check_limit()

    def _check_mission(self) -> None:
        if (self.fidelity == EXTERNAL) != (self.mission is not None):
            raise UserError(
                "the fidelity external and a mission file belong together; name one with --mission"
            )
        if self.mission is None:
            return
        ours = {"overrides": self.overrides, "conditions": self.conditions != (IDEAL_CONDITION,)}
        for what, given in ours.items():
            if given:
                raise UserError(f"{what} are of our own missions; with a mission file leave them out")
        if self.space != self.mission.space:
            raise UserError(f"the search space is that of {self.mission.path}; leave another one out")
        names = [instance.name for instance in self.mission.instances]
        for rock in self.rocks:
            if rock not in names:
                held = rock in [instance.name for instance in self.mission.held_out]
                why = "is held out: it may not be tuned on" if held else "is no instance"
                raise UserError(f"{rock!r} {why}; {self.mission.path} has {', '.join(names)} to tune on")

    def _check_conditions(self) -> None:
        own = {
            "overrides": self.overrides,
            "the search space": {**self.space.base, **dict.fromkeys(self.space.paths)},
        }
        for condition in self.conditions:
            for what, values in own.items():
                for path in values:
                    if any(p == path or p.startswith(f"{path}.") for p in condition.paths):
                        raise UserError(
                            f"{path} is set by condition {condition.name!r} and by {what}; leave one of them out"
                        )
            self.config(self.default_values(), condition.name)

    def _check_options(self) -> None:
        asked = {
            f"risk {self.risk}": self.risk != "mean",
            "a second objective": self.second is not None,
            "learning from earlier campaigns": bool(self.learn_from),
        }
        for what, wanted in asked.items():
            if wanted and self.sampler != "gp":
                raise UserError(f"{what} needs sampler gp, not {self.sampler}; leave it out or choose gp")
            if wanted and self.second is not None and what != "a second objective":
                raise UserError(f"{what} cannot be combined with a second objective; leave one of them out")
        if self.risk not in RISKS:
            raise UserError(f"unknown risk measure {self.risk!r}; there are {', '.join(RISKS)}")
        if self.risk != "mean" and len(self.worlds) < 2:
            raise UserError(
                f"risk measure {self.risk} is over rocks and conditions; name at least two of either"
            )

    def _check_limit(self) -> None:
        if self.limit is None:
            return
        if self.second is None:
            raise UserError(
                "a limit is of a second objective; name one, as in --objective f_score@photographs<=21"
            )
        if (
            self.second.metric not in COUNTS
            or self.second.direction != "minimise"
            or self.mission is not None
        ):
            return
        seeds, least = self._fewest_photographs()
        if self.limit < seeds:
            raise UserError(
                f"the limit of {self.limit:g} photographs is below the {seeds} seeds that every configuration here has; "
                "raise it, or tune or --set the seed phase"
            )
        if self.limit < least:
            raise UserError(
                f"the limit of {self.limit:g} photographs is below the {least} that every configuration here takes; "
                "raise it, or tune or --set stop.adaptive_budget"
            )

    def _fewest_photographs(self) -> tuple[int, int]:
        """``(seeds, photographs)`` at the ends of what is tuned of the seed phase and of the stopping rule."""
        tuned = [p for p in self.space.parameters if p.path.partition(".")[0] in ("seed", "stop")]
        default, found = self.default_values(), list[tuple[int, int]]()
        for ends in itertools.islice(itertools.product(*(p.ends for p in tuned)), 256):
            with contextlib.suppress(UserError):  # ends that exclude one another
                config = ours(self.config({**default, **{p.path: end for p, end in zip(tuned, ends)}}))
                seeds, stop = config.seed.total, config.stop
                may_end_early = stop.criterion != "budget" or stop.min_gain_percent > 0
                found.append((seeds, seeds + (0 if may_end_early else config.adaptive_budget)))
        return min((n for n, _ in found), default=0), min((n for _, n in found), default=0)

    @functools.cached_property
    def exact(self) -> Exact:
        """What of the objectives the configuration decides, as far as no mission says otherwise (`Exact.agreed`)."""
        found = [
            None if o is None else exact_cost(self.space, self.config, self.default_values(), o)
            for o in (self.objective, self.second)
        ]
        return Exact(*found)

    @property
    def at_least(self) -> float | None:
        """The limit as an outcome of the second objective, larger is better; a count may have half a one more."""
        if self.second is None or self.limit is None:
            return None
        return self.second.sign * self.limit - (0.5 if self.second.metric in COUNTS else 0.0)

    @property
    def worlds(self) -> tuple[World, ...]:
        """Every rock under every condition, in the order of their turns."""
        return worlds_over(self.rocks, [condition.name for condition in self.conditions])

    def base_config(self) -> Configuration:
        """The mission configuration on which conditions and tuned values are laid."""
        if self.mission is not None:
            return external_config(self.mission)
        return self._base

    @functools.cached_property
    def _base(self) -> MissionConfig:
        return self.space.base_config(preset(self.preset).with_values(self.overrides))

    def config(self, values: Mapping[str, Any], condition: str = IDEAL) -> Configuration:
        """The mission configuration at tuned ``values``, under one of the campaign's conditions or none."""
        if self.mission is not None:
            return external_config(self.mission, values)
        config = self._base.with_values(self.space.complete(values))
        named = {c.name: c for c in self.conditions}
        return config if condition == IDEAL else under(config, named[condition])

    def default_values(self) -> Values:
        """Where every sampler starts: the paper's values, or a mission file's defaults."""
        if self.mission is not None:
            return dict(external_config(self.mission).values)
        return self.space.default(preset(self.preset).with_values(self.overrides))

    @property
    def trusted_default(self) -> bool:
        """Whether half of the initial design stays near the default, whose values were chosen by hand.

        Not where the cheapest is sought: that is far away. Other samplers keep the designs their authors recommend.
        """
        return self.sampler == "gp" and (self.second is None or self.exact.first is None)

    def initial_size(self) -> int:
        """Missions of the initial design."""
        if self.initial is not None:
            return min(self.initial, self.budget)
        return initial_design_size(
            self.space.dimension,
            self.budget,
            trusted_default=self.trusted_default,
            earlier=bool(self.learn_from),
        )

    def to_dict(self) -> dict[str, Any]:
        """YAML form, as ``campaign.yaml`` has it; ``settings_file.settings_from_dict`` reads it back."""
        return {
            "name": self.name,
            "search_space": self.space.to_dict(),
            "rocks": list(self.rocks),
            "budget": self.budget,
            "replicates": self.replicates,
            "seed": self.seed,
            "preset": self.preset,
            "overrides": dict(self.overrides),
            "objective": {"metric": self.objective.metric, "direction": self.objective.direction},
            "sampler": self.sampler,
            "initial": self.initial_size(),
            "fidelity": self.fidelity,
            "keep": self.keep,
            "storage": self.storage,
            "risk": self.risk,
            "second": None if self.second is None else dataclasses.asdict(self.second),
            "limit": self.limit,
            "learn_from": list(self.learn_from),
            "in_step": self.in_step,
            "conditions": {condition.name: condition.to_dict() for condition in self.conditions},
            "mission": None
            if self.mission is None
            else {"file": str(self.mission.path), "sha256": self.mission.sha256},
        }
