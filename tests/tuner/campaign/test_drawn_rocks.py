"""Campaigns whose places are families: every mission meets a fresh rock, and the default beside it."""

from __future__ import annotations

import collections
import json

import pytest

from nbv.errors import UserError
from tuner.campaign.asked_settings import asked_settings
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import fly_campaign
from tuner.missions.executors import InProcessExecutor

BUDGET = 12


def settings_of(*rocks: str, **more: object):
    tree = {
        "name": "drawn",
        "space": "photographs",
        "rocks": list(rocks),
        "fidelity": "geometric",
        "budget": BUDGET,
        "sampler": "sobol",
        **more,
    }
    return asked_settings(tree, "test")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Interrupted after half of its missions, and resumed from the directory."""
    directory = tmp_path_factory.mktemp("drawn") / "run"
    whole = settings_of("any-slab", "any-boulder")
    begun = begin_campaign(directory, whole)

    def interrupt(event) -> None:
        if event.kind == "launched" and event.trial.number == BUDGET // 2:
            raise RuntimeError("interrupted")

    with pytest.raises(RuntimeError):
        fly_campaign(begun, InProcessExecutor(), interrupt)
    campaign = Campaign.open(directory)
    fly_campaign(campaign, InProcessExecutor())
    return campaign


@pytest.mark.slow
def test_every_fresh_rock_is_flown_by_a_proposal_and_by_the_default(flown: Campaign) -> None:
    default, trials = flown.settings.default_values(), flown.trials()
    assert len(trials) == BUDGET
    by_rock = collections.defaultdict(list)
    for t in trials:
        by_rock[t.rock, t.replicate].append(dict(t.values) == default)
    before_verification = [t for t in trials if t.number < BUDGET * 2 // 3]
    for t in before_verification[:-1]:
        assert any(by_rock[t.rock, t.replicate])
    proposals = [t for t in trials if dict(t.values) != default]
    assert len({(t.rock, t.replicate) for t in proposals}) == len(proposals)


@pytest.mark.slow
def test_the_rock_met_is_a_training_rock_that_the_seed_decides(flown: Campaign) -> None:
    met = []
    for t in flown.trials():
        result = json.loads((flown.directory / t.directory / "mission.json").read_text())
        family, seed = result["rock"].split("-")
        assert t.rock == f"any-{family}" and int(seed) < 10_000
        met.append((t.rock, t.replicate, result["rock"]))
    first = {(place, k): name for place, k, name in met}
    assert all(first[place, k] == name for place, k, name in met)
    assert len(set(first.values())) == len(first)
    other = settings_of("any-slab", seed=1)
    assert other.rock_flown("any-slab", 0) != flown.settings.rock_flown("any-slab", 0)


@pytest.mark.parametrize(
    ("rocks", "says"),
    [
        (["any-pebble"], "no family 'pebble' of rocks; choose from boulder, slab"),
        (["any-slab", "fin"], "any-slab is a family of rocks and 'fin' is a rock"),
        (["any", "any-slab"], "'any-slab' is named twice"),
    ],
)
def test_what_makes_no_such_campaign_is_said_in_one_line(rocks: list[str], says: str) -> None:
    with pytest.raises(UserError, match=says):
        settings_of(*rocks)
