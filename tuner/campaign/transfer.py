"""Learning from earlier campaigns: what was run on other rocks tells where to look on these.

A configuration that is good on some rocks tends to be good on others. The missions of earlier campaigns, moved into the
present search space, lead the initial design and inform the surrogate (``tuner.samplers.earlier_missions``); what they are worth
is decided by the missions of the campaign itself.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.shipped import SHIPPED, shipped_missions
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.problem.search_space import Configuration, SearchSpace, Values, value_at
from tuner.samplers.earlier_missions import MIN_OBSERVATIONS, EarlierMissions


def learn_from(
    directories: Sequence[str], space: SearchSpace, base: Configuration, objective: Objective
) -> EarlierMissions:
    """Return the missions of earlier campaigns that are configurations of ``space``.

    A mission counts where its tuned values lie in ``space``, what ``space`` does not tune is as in ``base``, and the
    objective's metric was measured. A parameter that ``space`` tunes and the earlier campaign did not has the value that
    campaign held it at.

    ``directories``: the campaigns' run directories, or ``shipped``. ``base``: the configuration on which its tuned
    values are laid.

    Raises `UserError`: no campaign in a directory, too few such missions in it, a directory named twice, or nothing
    shipped.
    """
    places = [SHIPPED if d == SHIPPED else str(Path(d).resolve()) for d in directories]
    for directory, place in zip(directories, places):
        if places.count(place) > 1:
            raise UserError(f"{directory} is named twice to learn from; name each campaign once")
    found: list[Observation] = []
    rocks: list[str] = []
    for number, directory in enumerate(directories, start=1):
        if directory == SHIPPED:
            one = shipped_missions(space, objective)
        else:
            one = _missions_of(directory, space, base, objective)
        # Two campaigns may have run one rock with different fidelities or presets: each has offsets of its own.
        names = {rock: f"{rock} ({number})" if rock in rocks else rock for rock in one.rocks}
        found += [dataclasses.replace(o, rock=names[o.rock]) for o in one.observations]
        rocks += names.values()
    return EarlierMissions(space, tuple(rocks), tuple(found))


def _missions_of(
    directory: str, space: SearchSpace, base: Configuration, objective: Objective
) -> EarlierMissions:
    campaign = Campaign.open(Path(directory), read_only=True)
    held, own = campaign.settings.base_config(), list[Observation]()
    for t in campaign.trials():
        values = _moved(t.values, held, space, base)
        if values is None or not t.status:
            continue
        raw = t.raw if objective == campaign.settings.objective else t.measured(objective)
        outcome = objective.oriented(raw)
        own.append(dataclasses.replace(t, values=values, raw=raw, outcome=outcome, second=None))
    measured = sum(o.feasible for o in own)
    if measured < MIN_OBSERVATIONS:
        raise UserError(
            f"{directory}: {measured} of its {len(campaign.trials())} missions are configurations of search space "
            f"{space.name!r} with {objective.metric} measured; to learn from it takes {MIN_OBSERVATIONS}. Name "
            "another campaign, or search the space it searched"
        )
    return EarlierMissions(space, campaign.settings.rocks, tuple(own))


def _moved(
    tuned: Mapping[str, Any], held: Configuration, space: SearchSpace, base: Configuration
) -> Values | None:
    """Return ``tuned`` values of a mission whose others are ``held``, in ``space``; None where it is no configuration of it."""
    if any(path not in space.paths and value != value_at(base, path) for path, value in tuned.items()):
        return None
    values = {path: tuned[path] if path in tuned else value_at(held, path) for path in space.paths}
    return values if all(p.contains(values[p.path]) for p in space.parameters) else None
