import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fake_campaigns
import pytest

from tuner.campaign.campaign import Campaign
from tuner.comparison.advice import Next, advice_of, next_step
from tuner.problem.intervals import Interval
from tuner.problem.space_files import load_search_space
from tuner.recommendation.recommendation import Recommendation
from tuner.report.answer import next_text, rock_table, worth_sentences
from tuner.report.campaign_page import bounds_text


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    space = load_search_space("gate")
    return fake_campaigns.run(tmp_path_factory.mktemp("c") / "run", space=space, sampler="sobol", budget=6)


def better(campaign: Campaign, **changes: Any) -> Recommendation:
    """A configuration that ran once is recommended, and believed to be better; with ``changes`` of that."""
    best = campaign.recommended()
    values = next(t.values for t in campaign.trials() if t.values != best.default_values)
    gain = {"improvement": 3.0, "improvement_sd": 0.5, "improvement_interval_95": (2.0, 4.0)}
    return dataclasses.replace(best, **{"values": values, **gain, **changes})


def test_what_is_sure_and_what_is_not(campaign: Campaign) -> None:
    said = worth_sentences(better(campaign), campaign.settings)
    assert "+3.0 [+2.0, +4.0] points" in said[0]


def test_what_next_follows_the_state(campaign: Campaign) -> None:
    best, s = better(campaign), campaign.settings
    assert step_of(campaign, best) is Next.EVALUATE
    assert step_of(campaign, better(campaign, values=s.problem.default)) is Next.KEEP
    wide = s.space.parameters[1]
    at_bound = {**s.problem.default, wide.path: wide.high}
    assert "d95" in bounds_text(better(campaign, values=at_bound), s) and not bounds_text(best, s)
    assert not bounds_text(better(campaign, values=at_bound, plain="orbit"), s)
    assert step_of(campaign, best, ["arch"]) is Next.MORE_INSTANCES
    on_three = ["arch", "fin", "horn"]
    assert step_of(campaign, best, on_three) is Next.FLY
    assert step_of(campaign, best, on_three, fly="orbit") is Next.FLY_PLAIN
    room = {"is_plain": True, "ceiling": Interval(5.0, 2.0, 8.0, 3, 6, "rocks")}
    assert step_of(campaign, best, on_three, **room) is Next.TRY_PLANNERS
    noisy = {"is_plain": True, "ceiling": Interval(-0.7, -3.8, 2.4, 5, 10, "rocks")}
    assert step_of(campaign, best, on_three, **noisy) is Next.FLY
    assert step_of(campaign, best, on_three, is_plain=True) is Next.FLY
    for step in Next:  # each has its words and, unless nothing is to be done, a command
        why, command = next_text(step, campaign, None)
        assert why and (command.startswith("gatetune") or step is Next.KEEP)


def step_of(campaign: Campaign, best: Recommendation, held_out: Sequence[str] = (), **of_advice: Any) -> Next:
    """What to do next, with results of the recommendation on these held-out rocks."""
    advice = advice_of(campaign, best)
    trial = next(t for t in campaign.trials() if t.record.status)
    records = [dataclasses.replace(trial, rock=rock, strategy="tuned") for rock in held_out]
    if held_out:
        results = dataclasses.replace(advice.results, held_out=True, records=records)
        advice = dataclasses.replace(advice, results=results, over_plain=None, **of_advice)
    return next_step(campaign, best, advice)


def test_a_mesh_file_is_called_by_its_name(tmp_path: Path) -> None:
    asked = {
        "space": load_search_space("gate"),
        "rocks": ("scans/one.obj", "fin"),
        "budget": 6,
        "replicates": 1,
    }
    campaign = fake_campaigns.run(tmp_path / "run", sampler="sobol", **asked)
    best = campaign.recommendation(save=False)
    assert [row.name for row in rock_table(best, campaign).rows] == ["one", "fin"]
