"""What a campaign was asked to do, and the file in its run directory that says so."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.mission.runner import Keep
from tuner.missions.registry import DEFAULT_RUNNER
from tuner.problem.objective import Objective
from tuner.problem.options import RISKS, Risk
from tuner.problem.search_space import SearchSpace, Values, space_from_dict
from tuner.samplers.base import Sampler, SamplerSettings
from tuner.samplers.design import initial_design_size
from tuner.samplers.registry import ALL_SAMPLER_NAMES, make_sampler
from tuner.surrogate.settings import SurrogateSettings, surrogate_settings

if TYPE_CHECKING:
    from tuner.samplers.earlier_missions import EarlierMissions

SETTINGS_FILE = "campaign.yaml"
FORMAT_VERSION = 2  # 1: could ask for what is gone, and was proposed for by another model


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
    runner: str = DEFAULT_RUNNER  # a name of tuner.missions.registry, or module:function
    keep: Keep = "summary"
    storage: str | None = None  # None: study.journal in the run directory
    risk: Risk = "mean"  # over the training rocks: tune their mean, or the worst of them
    second: Objective | None = None  # search the front between the objective and this one
    learn_from: tuple[str, ...] = ()  # run directories of earlier campaigns, see tuner.campaign.transfer
    # A proposal knows every earlier mission but the last in_step - 1, whichever of those have ended: the same campaign
    # with any number of workers (of which in_step have work). None: it knows what has ended, so that nobody waits.
    in_step: int | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise UserError("the campaign needs a name")
        if self.budget < 1:
            raise UserError(f"the budget is {self.budget} missions; give at least 1")
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        if self.in_step is not None and self.in_step < 1:
            raise UserError(f"in step is {self.in_step} missions; give at least 1")
        if self.seed < 0:
            raise UserError(f"the seed is {self.seed}; give 0 or more")
        if not self.rocks:
            raise UserError("the campaign has no rocks; name at least one")
        twice = [rock for rock, count in collections.Counter(self.rocks).items() if count > 1]
        if twice:
            raise UserError(f"rock {twice[0]!r} is named twice; name each rock once")
        if self.initial is not None and self.initial < 1:
            raise UserError(f"the initial design has {self.initial} missions; give at least 1")
        self._check_options()
        if self.sampler not in ALL_SAMPLER_NAMES:
            raise UserError(f"unknown sampler {self.sampler!r}; there are {', '.join(ALL_SAMPLER_NAMES)}")
        self.default_values()  # the space must fit the preset

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
        if self.risk != "mean" and len(self.rocks) < 2:
            raise UserError(f"risk measure {self.risk} is over rocks; name at least two")

    def base_config(self) -> MissionConfig:
        """The mission configuration on which tuned values are laid."""
        return self.space.base_config(preset(self.preset).with_values(self.overrides))

    def config(self, values: Mapping[str, Any]) -> MissionConfig:
        """The mission configuration at tuned ``values``."""
        return self.base_config().with_values(self.space.complete(values))

    def default_values(self) -> Values:
        """Where every sampler starts: the paper's values."""
        return self.space.default(preset(self.preset).with_values(self.overrides))

    def initial_size(self) -> int:
        """Missions of the initial design."""
        if self.initial is not None:
            return min(self.initial, self.budget)
        # The paper's values were chosen by hand. Other samplers keep the designs their authors recommend.
        trusted = self.sampler == "gp"
        return initial_design_size(
            self.space.dimension, self.budget, trusted_default=trusted,
            earlier=bool(self.learn_from),
        )  # fmt: skip

    def make_sampler(self, earlier: EarlierMissions | None = None) -> Sampler:
        """The sampler at work; ``earlier``: missions flown before the campaign."""
        settings = SamplerSettings(
            self.space, self.default_values(), self.rocks, self.seed, self.initial_size(), self.replicates,
            self.risk, earlier, self.second is not None, self.budget,
            trusted_default=True,
        )  # fmt: skip
        return make_sampler(self.sampler, settings)

    def surrogate(self) -> SurrogateSettings:
        """What sampler gp, the recommendation and the report model."""
        return surrogate_settings(self.space, self.risk)

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
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
            "runner": self.runner,
            "keep": self.keep,
            "storage": self.storage,
            "risk": self.risk,
            "second": None if self.second is None else dataclasses.asdict(self.second),
            "learn_from": list(self.learn_from),
            "in_step": self.in_step,
        }

    @staticmethod
    def from_dict(tree: Mapping[str, Any], source: str) -> CampaignSettings:
        """The inverse of ``to_dict``; ``source`` names the file in messages."""
        try:
            return CampaignSettings(
                name=tree["name"],
                space=space_from_dict(tree["search_space"], source),
                rocks=tuple(tree["rocks"]),
                budget=tree["budget"],
                replicates=tree["replicates"],
                seed=tree["seed"],
                preset=tree["preset"],
                overrides=dict(tree["overrides"]),
                objective=Objective(tree["objective"]["metric"], tree["objective"]["direction"]),
                sampler=tree["sampler"],
                initial=tree["initial"],
                runner=tree["runner"],
                keep=tree["keep"],
                storage=tree["storage"],
                risk=tree["risk"],
                second=Objective(**tree["second"]) if tree.get("second") else None,
                learn_from=tuple(tree.get("learn_from") or ()),
                in_step=tree.get("in_step"),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{source} is not a campaign's settings ({error!r}); restore the file") from error


def read_settings(directory: Path) -> tuple[dict[str, Any], str, str]:
    path = directory / SETTINGS_FILE
    if not path.is_file():
        raise UserError(
            f"{directory} holds no campaign ({SETTINGS_FILE} is missing); name a campaign's directory"
        )
    try:
        tree = yaml.safe_load(path.read_text())
        if tree["format"] != FORMAT_VERSION:
            raise UserError(
                f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}; open the campaign with the "
                "version that began it"
            )
        return tree["settings"], tree["id"], tree["base_config_digest"]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise UserError(f"{path} is not a campaign's settings ({error!r}); restore the file") from error


def first_difference(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    for key in wanted:
        if stored.get(key) != wanted[key]:
            if key == "search_space":
                return f"search space {stored[key].get('name')!r} differs from {wanted[key].get('name')!r}"
            return f"{key} is {stored.get(key)!r} there, not {wanted[key]!r}"
    return ""
