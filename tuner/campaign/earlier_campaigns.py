"""The missions of earlier campaigns, moved into a search space: a campaign's sampler learns from them.

Of the new campaign only its problem and its objective are known here, and of an earlier one only what it recorded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.mission_problem import MissionProblem
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values, value_at
from tuner.samplers.earlier_missions import EarlierMissions

MIN_OBSERVATIONS = 20  # with the metric, of an earlier campaign


def learn_from(directories: Sequence[str], problem: MissionProblem, objective: Objective) -> EarlierMissions:
    """Return the missions of earlier campaigns that are configurations of the problem's space.

    A mission counts where its tuned values lie in the space and the objective's metric was measured. A parameter that the space
    tunes and the earlier campaign did not has the value that campaign held it at; one that only the earlier campaign tuned has
    to be as in the problem's base configuration. What neither tunes may differ, as rocks and fidelity may: earlier missions
    only say which configurations run first.

    ``directories``: the campaigns' run directories.

    Raises `UserError`: no campaign in a directory, too few such missions in it, or a directory named twice.
    """
    places = [Path(directory).resolve() for directory in directories]
    for directory, place in zip(directories, places):
        if places.count(place) > 1:
            raise UserError(f"{directory} is named twice to learn from; name each campaign once")
    observations: list[Observation] = []
    rocks: list[str] = []
    seen: set[str] = set()
    for number, directory in enumerate(directories, start=1):
        one = _missions_of(directory, problem, objective)
        # Two campaigns may have run one rock with different fidelities or presets: each has offsets of its own.
        names = {rock: f"{rock} ({number})" if rock in rocks else rock for rock in one.rocks}
        observations += [dataclasses.replace(o, rock=names[o.rock]) for o in one.observations]
        rocks += names.values()
        seen |= one.seen
    return EarlierMissions(problem.space, tuple(rocks), tuple(observations), frozenset(seen))


def _missions_of(directory: str, problem: MissionProblem, objective: Objective) -> EarlierMissions:
    earlier = Campaign.open(Path(directory), read_only=True)
    trials, observations = earlier.trials(), list[Observation]()
    for t in trials:
        values = _values_in(problem, t.values, held=earlier.settings.problem.base)
        if values is None or not t.record.status:
            continue
        raw = t.raw if objective == earlier.settings.objective else t.measured(objective)
        outcome = objective.oriented(raw)
        observations.append(dataclasses.replace(t, values=values, raw=raw, outcome=outcome, second=None))
    measured = sum(o.feasible for o in observations)
    if measured < MIN_OBSERVATIONS:
        raise UserError(
            f"{directory}: {measured} of its {len(trials)} missions are configurations of search space "
            f"{problem.space.name!r} with {objective.metric} measured; to learn from it takes {MIN_OBSERVATIONS}. Name "
            "another campaign, or search the space it searched"
        )
    return EarlierMissions(
        problem.space, earlier.settings.rocks, tuple(observations), frozenset(earlier.rocks_seen())
    )


def _values_in(problem: MissionProblem, tuned: Mapping[str, Any], held: MissionConfig) -> Values | None:
    """Return ``tuned`` values of a mission whose others are ``held``, in the problem's space; None where it is no configuration of it."""
    space = problem.space
    if any(
        path not in space.paths and value != value_at(problem.base, path) for path, value in tuned.items()
    ):
        return None
    values = {path: tuned[path] if path in tuned else value_at(held, path) for path in space.paths}
    return values if all(p.contains(values[p.path]) for p in space.parameters) else None
