"""What the gate of a tuned configuration did, from the traces of its missions."""

from __future__ import annotations

import collections
import contextlib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass

from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.campaign.campaign import Campaign
from tuner.recommendation.recommendation import Recommendation


@dataclass(frozen=True)
class GateFacts:
    """Over the missions of the campaign that flew one configuration, and over all its missions that planned a view."""

    missions: int  # that flew the configuration
    switched: int  # of these: views of more than one scorer were taken
    views: Mapping[str, int]  # planned views by the scorer that chose them
    d95_m: tuple[float, float] | None  # between which the statistic lay when a view was chosen
    all_missions: int  # of the campaign, that planned a view
    all_switched: int
    scorer: str  # the geometry scorer
    budget_fraction: float
    threshold_m: float
    alone: str  # the scorer that the thresholds leave alone whatever is measured; empty without one


def gate_facts(campaign: Campaign, tuned: Recommendation) -> GateFacts:
    """Return what the gate did; files of missions that are gone are left out."""
    gate = campaign.settings.problem.config(tuned.values).gate
    trials = [t for t in campaign.trials() if t.state == "complete" and t.record.switched is not None]
    flown = [t for t in trials if dict(t.values) == dict(tuned.values)]
    traces = []
    for t in flown:
        with contextlib.suppress(UserError, OSError):
            traces.append(MissionResult.load(t.record.directory).trace)
    steps = list(itertools.chain(*traces))
    d95_m = [step.d95_m for step in steps if step.d95_m is not None]
    alone = ""
    if gate.kind == "hyb-h":
        if gate.budget_fraction >= 1.0:
            alone = gate.geometry_scorer
        elif gate.budget_fraction <= 0.0 and d95_m and gate.d95_m >= max(d95_m):
            alone = "covis"
    return GateFacts(
        missions=len(flown),
        switched=sum(bool(t.record.switched) for t in flown),
        views=dict(collections.Counter(step.scorer for step in steps).most_common()),
        d95_m=(min(d95_m), max(d95_m)) if d95_m else None,
        all_missions=len(trials),
        all_switched=sum(bool(t.record.switched) for t in trials),
        scorer=gate.geometry_scorer,
        budget_fraction=gate.budget_fraction,
        threshold_m=gate.d95_m,
        alone=alone,
    )
