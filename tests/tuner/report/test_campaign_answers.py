import dataclasses
from collections.abc import Sequence
from typing import Any

import fake_campaigns
import pytest

from tuner.campaign.campaign import Campaign
from tuner.comparison.advice import Next, next_step
from tuner.problem.intervals import Interval
from tuner.problem.space_files import load_search_space
from tuner.recommendation.recommendation import NextRock
from tuner.report.answer import next_text
from tuner.report.campaign_page import CampaignFacts, bounds_text, sure_answer


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    space = load_search_space("gate")
    return fake_campaigns.run(tmp_path_factory.mktemp("c") / "run", space=space, sampler="sobol", budget=6)


def better(campaign: Campaign, **changes: Any) -> CampaignFacts:
    """A configuration that ran once is recommended, and believed to be better; with ``changes`` of that."""
    facts = CampaignFacts(campaign)
    best = facts.recommendation
    values = next(t.values for t in facts.trials if t.values != facts.default)
    gain = {"improvement": 3.0, "improvement_sd": 0.5, "improvement_interval_95": (2.0, 4.0)}
    facts.__dict__["recommendation"] = dataclasses.replace(best, **{"values": values, **gain, **changes})
    facts.settings = dataclasses.replace(facts.settings, fidelity="photogrammetric")
    return facts


def test_what_is_sure_and_what_is_not(campaign: Campaign) -> None:
    said = sure_answer(better(campaign))
    assert "+3.0 [+2.0, +4.0] points" in said[0] and not any("disagree" in line for line in said)
    elsewhere = NextRock(3.0, (1.0, 5.0), {"cleft": -2.0}, ("cleft",), 0.9)
    assert any(
        "disagree" in line and "cleft" in line for line in sure_answer(better(campaign, next_rock=elsewhere))
    )


def test_what_next_follows_the_state(campaign: Campaign) -> None:
    facts = better(campaign)
    assert step_of(facts) is Next.EVALUATE
    assert step_of(better(campaign, values=facts.default, runner_up=None)) is Next.KEEP
    wide = facts.settings.space.parameters[1]
    edge = better(campaign, values={**facts.default, wide.path: wide.high})
    assert "d95" in bounds_text(edge) and not bounds_text(facts)
    assert not bounds_text(better(campaign, values={**facts.default, wide.path: wide.high}, plain="orbit"))
    assert step_of(facts, ["arch"]) is Next.MORE_INSTANCES
    on_three = ["arch", "fin", "horn"]
    assert step_of(facts, on_three) is Next.FLY
    assert step_of(facts, on_three, fly="orbit") is Next.FLY_PLAIN
    room = {"is_plain": True, "ceiling": Interval(5.0, 2.0, 8.0, 3, 6, "rocks")}
    assert step_of(facts, on_three, **room) is Next.TRY_PLANNERS
    noisy = {"is_plain": True, "ceiling": Interval(-0.7, -3.8, 2.4, 5, 10, "rocks")}
    assert step_of(facts, on_three, **noisy) is Next.FLY
    assert step_of(facts, on_three, is_plain=True) is Next.FLY
    for step in Next:  # each has its words and, unless nothing is to be done, a command
        why, command = next_text(step, campaign, None)
        assert why and (command.startswith("gatetune") or step is Next.KEEP)


def step_of(facts: CampaignFacts, held_out: Sequence[str] = (), **of_advice: Any) -> Next:
    """What to do next, with results of the recommendation on these held-out rocks."""
    advice = facts.advice
    trial = next(t for t in facts.trials if t.record.status)
    records = [dataclasses.replace(trial, rock=rock, strategy="tuned") for rock in held_out]
    if held_out:
        results = dataclasses.replace(advice.results, held_out=True, records=records)
        advice = dataclasses.replace(advice, results=results, **of_advice)
    return next_step(facts.campaign, facts.recommendation, advice)
