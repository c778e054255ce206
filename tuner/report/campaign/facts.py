"""What a campaign's report shows, computed once: trials, model, recommendation, slices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nbv.types import Floats
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignStatus
from tuner.campaign.session import MAX_CONSECUTIVE_FAILURES
from tuner.campaign.settings import CampaignSettings
from tuner.missions.job import Trial
from tuner.problem.objective import Objective
from tuner.problem.search_space import Parameter
from tuner.problem.worlds import World
from tuner.recommendation.recommendation import Recommendation
from tuner.report.labels import MetricLabel, decimals_for, metric_label
from tuner.report.style import short_names
from tuner.surrogate.model import RockMeanGP

SLICE_POINTS = 61


@dataclass(frozen=True)
class Slice:
    """Posterior of the mean over the training rocks along one parameter, the others as recommended."""

    parameter: Parameter
    positions: tuple[Any, ...]  # values along the axis
    mean: Floats  # metric's unit
    sd: Floats


class CampaignFacts:
    """Lazily computed facts of one campaign; nothing is written.

    ``recommendation`` and ``model`` are None while no mission has succeeded.
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.settings: CampaignSettings = campaign.settings
        self.trials: list[Trial] = campaign.trials()
        self.status: CampaignStatus = campaign.status()
        self.modelled: Objective = campaign.modelled_objective  # of the model and its checks
        self.label: MetricLabel = metric_label(self.modelled.metric)
        self.sign = self.modelled.sign
        self.default: dict[str, Any] = self.settings.default_values()
        self.rock_names: dict[str, str] = dict(zip(self.settings.rocks, short_names(self.settings.rocks)))
        self.several_conditions = len(self.settings.conditions) > 1

    @cached_property
    def recommendation(self) -> Recommendation | None:
        """After all finished missions; the very one that status, export and evaluation have."""
        return self.campaign.recommendation(save=False)

    @cached_property
    def model(self) -> RockMeanGP | None:
        """The surrogate behind the recommendation; None, too, where the configuration decides all that was asked."""
        feasible = [o for o in self.campaign.history(self.trials) if o.feasible]
        if not feasible or (self.settings.second is None and self.campaign.exact(feasible).first is not None):
            return None
        return self.campaign.surrogate_from(feasible)

    @property
    def digits(self) -> int:
        """Decimals with which the modelled metric is written: what its uncertainty deserves."""
        best = self.recommendation
        if best is None:
            return 2
        return decimals_for(
            best.limit.sd if best.exact and best.limit is not None else best.sd or best.noise_sd
        )

    def outcome(self, trial: Trial) -> float | None:
        """What a mission had of the modelled metric."""
        return trial.raw if self.modelled == self.settings.objective else trial.measured(self.modelled)

    @property
    def stop_reason(self) -> str:
        """Why missions of the budget are left, as the ledger tells."""
        status = self.status
        last = [t for t in self.trials if t.state != "running"][-MAX_CONSECUTIVE_FAILURES:]
        if len(last) == MAX_CONSECUTIVE_FAILURES and all(t.state == "failed" for t in last):
            return (
                f"Stopped after {MAX_CONSECUTIVE_FAILURES} failures in a row, the last with {last[-1].reason!r}; "
                f"{status.finished} of {status.budget} missions are finished."
            )
        flying = f", {status.running} in flight or interrupted" if status.running else ""
        return f"Not finished: {status.finished} of {status.budget} missions{flying}."

    @cached_property
    def adjusted(self) -> Floats:
        """(n,) feasible outcomes with the worlds' differences taken out, metric's unit (for plots)."""
        assert self.model is not None
        offset, factor = self.model.standardiser.mean_over([world.rock for world in self.model.worlds])
        return self.sign * (offset + factor * self.model.targets)

    @cached_property
    def slices(self) -> list[Slice]:
        """One per parameter, through the recommendation."""
        if self.recommendation is None or self.model is None:
            return []
        out = []
        for p in self.settings.space.parameters:
            if p.kind == "categorical":
                positions: list[Any] = list(p.choices)
            else:
                positions = sorted({p.from_unit(float(u)) for u in np.linspace(0.0, 1.0, SLICE_POINTS)})
            belief = self.model.posterior([{**self.recommendation.values, p.path: v} for v in positions])
            out.append(Slice(p, tuple(positions), self.sign * belief.mean, belief.sd))
        return out

    def world_name(self, world: World) -> str:
        """``slab``, or ``slab, field`` where there is more than one condition."""
        rock = self.rock_names.get(world.rock, world.rock)
        return f"{rock}, {world.condition}" if self.several_conditions else rock
