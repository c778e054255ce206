"""A wider search space for a recommendation that lies at a bound, as settings that keep everything else."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.safe_files import write_atomic
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings import CampaignSettings
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.recommendation.recommendation import Recommendation

WIDER_FILE = "wider.yaml"  # in a campaign's directory
EDGE = 0.005  # of the searched range: nearer to a bound counts as at it
LEAST_ROOM = 0.1  # of the searched range: a bound with less beyond it, which can be flown, stays
BEYOND = 0.5  # of the searched range that is added
_STEPS = 20


@dataclass(frozen=True)
class WiderSpace:
    """The space and the parameters that are wider in it."""

    space: SearchSpace
    widened: tuple[str, ...]


def wider_space(s: CampaignSettings, best: Recommendation) -> WiderSpace | None:
    """The space with room beyond each bound that ``best`` lies at; None where no mission could fly there."""
    if s.mission is not None:
        return None
    changed = [p for p in s.space.parameters if p.path in best.changed]
    wider = {p.path: found for p in changed if (found := _wider(s, p, best.values))}
    if not wider:
        return None
    parameters = tuple(wider.get(p.path, p) for p in s.space.parameters)
    name = f"{s.space.name}_wider".replace("_wider_wider", "_wider")
    return WiderSpace(dataclasses.replace(s.space, name=name, parameters=parameters), tuple(wider))


def write_wider_settings(campaign: Campaign, best: Recommendation) -> None:
    """Write `WIDER_FILE`, which learns from this campaign where it may, if there is a wider space to search."""
    s = campaign.settings
    found = wider_space(s, best)
    if found is not None:
        settings = dataclasses.replace(s, name=f"{s.name}-wider", space=found.space)
        learns = s.sampler == "gp" and s.second is None
        tree = {
            **settings.to_dict(),
            "learn_from": ["./"] if learns else [],
        }  # the slash: the file's directory
        text = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
        write_atomic(campaign.directory / WIDER_FILE, text)


def _wider(s: CampaignSettings, p: Parameter, values: Mapping[str, Any]) -> Parameter | None:
    if p.kind == "categorical":
        return None
    at = p.to_unit(values[p.path])
    if EDGE < at < 1 - EDGE:
        return None
    low = at <= EDGE
    steps = max(_STEPS, round(BEYOND * (p.high - p.low)))  # so many that no integer is left out
    outward = ((-1 if low else 1) * BEYOND * k / steps + (not low) for k in range(1, steps + 1))
    # Up to the first that cannot be flown: the search may propose whatever lies between.
    flown = list(itertools.takewhile(lambda u: _flies(s, p, values, u), outward))
    reach = flown[-1] if flown else None
    if reach is None or abs(reach - at) < LEAST_ROOM:
        return None
    bound = _beyond(p, reach)
    return dataclasses.replace(p, low=bound) if low else dataclasses.replace(p, high=bound)


def _flies(s: CampaignSettings, p: Parameter, values: Mapping[str, Any], u: float) -> bool:
    """Whether a mission with the value at ``u`` of the searched range is one that can be flown."""
    try:
        return isinstance(s.config({**values, p.path: _beyond(p, u)}), MissionConfig)
    except UserError:
        return False


def _beyond(p: Parameter, u: float) -> Any:
    value = p.low * (p.high / p.low) ** u if p.scale == "log" else p.low + u * (p.high - p.low)
    return round(value) if p.kind == "int" else float(f"{value:.4g}")
