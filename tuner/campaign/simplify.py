"""The recommendations without what has no effect: parameters whose default would have led to the same photographs.

A gate that never switches makes its thresholds, and the weights of the scorer that it never asks, values of nothing. Which
values these are is found by missions whose every photograph and model is in the store, and which therefore take no time. The
simplified configuration then enters the ledger by trials that repeat those of the recommendation and use no budget.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from nbv.cache import KnownOnly
from nbv.errors import MissionFailure
from tuner.campaign.campaign import Campaign
from tuner.missions.job import MissionJob, Trial
from tuner.missions.registry import kind_on, uses_store
from tuner.problem.observations import Proposal, configuration_key, photographs_key
from tuner.problem.search_space import Values
from tuner.recommendation.recommendation import Recommendation


def simplified(campaign: Campaign) -> list[Proposal]:
    """Return trials of the recommendations with all values at their default that change no photograph of their own trials.

    The list is empty where there is no such value, or where the simplified configurations have been tried already.
    """
    return [
        proposal
        for best in campaign.recommendations(save=False).values()
        for proposal in _simplified(campaign, best)
    ]


def _simplified(campaign: Campaign, best: Recommendation) -> list[Proposal]:
    s = campaign.settings
    if best.keep_default:
        return []
    trials, space = campaign.trials(), s.space
    best_trials = [t for t in trials if t.state == "complete" and t.values == best.values]
    if not best_trials or not all(t.record.photographs for t in best_trials):
        return []
    values = dict(best.values)
    for paths in _parts(best.changed):
        trial = {**values, **{path: best.default_values[path] for path in paths}}
        if trial != values and _same_photographs(campaign, best_trials, trial):
            values = trial
    tried = {configuration_key(space, t.values) for t in trials}
    if values == best.values or configuration_key(space, values) in tried:
        return []
    reset = [path for path in best.changed if values[path] == best.default_values[path]]
    metadata = {"sampler": s.sampler, "phase": "simplified", "without_effect": reset, "region": best.name}
    return [Proposal(values, metadata, t.instance, t.replicate) for t in best_trials]


def _parts(changed: Sequence[str]) -> list[tuple[str, ...]]:
    """Return what to reset, one after the other: sections of the configuration, then single parameters."""
    sections = itertools.groupby(sorted(changed), key=lambda path: path.partition(".")[0])
    return [*(tuple(paths) for _, paths in sections), *((path,) for path in changed)]


def _same_photographs(campaign: Campaign, best_trials: Sequence[Trial], values: Values) -> bool:
    config = campaign.settings.problem.config
    return all(
        known_photographs(campaign.job(trial, config(values, trial.condition))) == trial.record.photographs
        for trial in best_trials
    )


def known_photographs(job: MissionJob) -> str:
    """Return the `photographs_key` of a mission that repeats an earlier one; in a tenth of a second, for nothing is computed.

    The text is empty where a model or a photograph of it has never been made here, or where the mission fails.
    """
    if not uses_store(job.fidelity):
        return ""
    run = kind_on(job.rock, job.fidelity)
    try:
        result = run(job.config, job.rock, job.replicate, None, keep="summary", cache=KnownOnly())
    except MissionFailure:
        return ""
    chosen = [step.chosen for step in result.trace]
    return "" if result.status == "failed" else photographs_key(job.config, chosen)
