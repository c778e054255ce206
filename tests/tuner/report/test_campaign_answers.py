"""The first screen of the campaign's page: each answer in constructed states."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import fake_campaigns
import pytest

from tuner.campaign.campaign import Campaign
from tuner.comparison.advice import Next, Results, next_step
from tuner.missions.job import Trial
from tuner.problem.intervals import Interval
from tuner.problem.space_files import load_search_space
from tuner.recommendation.recommendation import NextRock
from tuner.report.answer import next_text, use_sentence
from tuner.report.campaign_page import (
    CampaignFacts,
    bounds_text,
    sure_answer,
)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    space = load_search_space("gate")
    return fake_campaigns.run(tmp_path_factory.mktemp("c") / "run", space=space, sampler="sobol", budget=6)


def facts_of(campaign: Campaign, fidelity: str = "photogrammetric", **changes: Any) -> CampaignFacts:
    """Of the campaign, with ``changes`` of its recommendation."""
    facts = CampaignFacts(campaign)
    best = facts.recommendation
    assert best is not None
    facts.__dict__["recommendation"] = dataclasses.replace(best, **changes)
    facts.settings = dataclasses.replace(facts.settings, fidelity=fidelity)
    return facts


def other(facts: CampaignFacts) -> Trial:
    return next(t for t in facts.trials if t.values != facts.default)


def better(campaign: Campaign, fidelity: str = "photogrammetric", **changes: Any) -> CampaignFacts:
    """A configuration that ran once is recommended, and believed to be better."""
    values = other(CampaignFacts(campaign)).values
    gain = {"improvement": 3.0, "improvement_sd": 0.5, "improvement_interval_95": (2.0, 4.0)}
    return facts_of(campaign, fidelity, **{"values": values, **gain, **changes})


def test_a_predicted_gain_has_its_interval(campaign: Campaign) -> None:
    facts = better(campaign)
    said = sure_answer(facts)
    assert "+3.0 [+2.0, +4.0] points" in said[0]
    assert step_of(facts) is Next.EVALUATE


def test_rocks_that_disagree_are_named(campaign: Campaign) -> None:
    elsewhere = NextRock(3.0, (1.0, 5.0), {"cleft": -2.0}, ("cleft",), 0.9)
    said = sure_answer(better(campaign, next_rock=elsewhere))
    assert "Training rocks disagree: it is probably worse than the default on cleft." in said
    assert not any("disagree" in line for line in sure_answer(better(campaign)))


def test_where_nothing_is_needed_the_default_is_used(campaign: Campaign) -> None:
    default = CampaignFacts(campaign).default
    facts = better(campaign, values=default, runner_up=None)
    best = facts.recommendation
    assert best is not None and use_sentence(best, facts.settings).startswith("Keep the default")
    assert step_of(facts) is Next.KEEP and next_text(Next.KEEP, campaign, None)[1] == ""


def test_what_next_follows_the_state(campaign: Campaign) -> None:
    facts = better(campaign)
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
    assert advice is not None
    trial = next(t for t in facts.trials if t.record.status)
    records = [dataclasses.replace(trial, rock=rock, strategy="tuned") for rock in held_out]
    if held_out:
        advice = dataclasses.replace(
            advice, results=Results(True, records, advice.results.strategies, True), **of_advice
        )
    return next_step(facts.campaign, facts.recommendation, advice)
