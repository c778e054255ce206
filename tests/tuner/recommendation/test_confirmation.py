"""The confirmation stage: who meets whom where, and what is said afterwards."""

from __future__ import annotations

import functools
import os
import signal
from pathlib import Path

import fake_campaigns
import numpy as np
import pytest
import synthetic
from hypothesis import given
from hypothesis import strategies as st

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignEvent
from tuner.campaign.settings import CampaignSettings
from tuner.missions.executors import InProcessExecutor, LocalProcessExecutor
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.recommendation.confirmation import (
    choose_finalists,
    confirmation_missions,
    finalist_count,
    paired_gain,
    schedule,
)
from tuner.recommendation.recommendation import recommend

A, B, C = (synthetic.SPACE.from_unit(u) for u in ([0.7, 0.3], [0.2, 0.8], [0.5, 0.5]))


settings = functools.partial(
    fake_campaigns.settings, budget=14, replicates=2, sampler="sobol", confirmation=0.45
)


@given(st.integers(2, 4), st.integers(1, 6), st.integers(2, 40), st.integers(0, 5))
def test_every_finalist_flies_every_whole_round_on_a_fresh_slot(
    finalists: int, rocks: int, missions: int, first: int
) -> None:
    names = [f"r{i}" for i in range(rocks)]
    values = [{"x": i} for i in range(finalists)]
    plan = schedule(values, names, first, missions)
    assert len(plan) == missions
    met = {(p.rock, p.replicate, p.values["x"]) for p in plan}
    assert len(met) == missions  # nobody flies a slot twice
    assert all(p.replicate is not None and p.replicate >= first for p in plan)
    counts = [sum(p.values["x"] == i for p in plan) for i in range(finalists)]
    assert max(counts) - min(counts) <= 1
    visits = [sum(p.rock == name for p in plan) for name in names]
    assert max(visits) - min(visits) <= finalists


def test_finalists_are_the_best_and_the_default() -> None:
    space, default = synthetic.SPACE, synthetic.DEFAULT
    assert choose_finalists(space, [A, B, C], default, 3) == [A, B, default]
    assert choose_finalists(space, [A, default, C], default, 3) == [A, C, default]
    assert choose_finalists(space, [default], default, 4) == [default]
    near = space.from_unit(space.to_unit(A) + 0.02)
    lengths = dict.fromkeys(space.paths, 0.5)
    assert choose_finalists(space, [A, near, B], default, 3, lengths) == [A, B, default]
    assert choose_finalists(space, [A, near, B], default, 3, dict.fromkeys(space.paths, 0.02)) == [
        A,
        near,
        default,
    ]
    assert finalist_count(13, 3) == 4 and finalist_count(16, 6) == 2 and finalist_count(2, 4) == 2
    assert confirmation_missions(64, 0.2) == 13 and confirmation_missions(64, 0.0) == 0


def test_paired_gain_cancels_slots() -> None:
    slot = {("a", 2): 50.0, ("b", 2): -30.0, ("a", 3): 0.0}
    gains = [1.0, 2.0, 3.0]
    own = [
        Observation(i, A, r, k, y + g, None)
        for i, ((r, k), y, g) in enumerate(zip(slot, slot.values(), gains))
    ]
    other = [
        Observation(9 + i, synthetic.DEFAULT, r, k, y, None) for i, ((r, k), y) in enumerate(slot.items())
    ]
    result = paired_gain(A, own, other)
    assert result.pairs == 3 and result.gain == pytest.approx(2.0)
    assert result.gain_interval_95 is not None  # t(2) = 4.303, sd 1
    assert result.gain_interval_95[1] == pytest.approx(2 + 4.30265 / np.sqrt(3), abs=1e-4)
    failed = [*own[:1], Observation(1, A, "b", 2, None, None, "timeout")]
    single = paired_gain(A, failed, other)
    assert (single.missions, single.pairs, single.gain_interval_95) == (1, 1, None)
    assert paired_gain(A, own, []).gain is None


def test_only_confirmed_configurations_can_win() -> None:
    """C leads after the search by luck that the model believes; it was not confirmed."""
    history = [
        Observation(i, v, "r0", i % 2, y, None) for i, (v, y) in enumerate([(A, 1.0), (B, 0.5), (C, 1.6)] * 2)
    ]
    objective = Objective()
    before = recommend(synthetic.SPACE, history, ("r0",), synthetic.DEFAULT, objective)
    assert before is not None and before.values == C and before.confirmation == []
    finals = [
        Observation(6 + i, v, "r0", 2 + i // 2, y, None)
        for i, (v, y) in enumerate([(A, 1.1), (synthetic.DEFAULT, 0.6), (A, 1.0), (synthetic.DEFAULT, 0.4)])
    ]
    after = recommend(
        synthetic.SPACE, [*history, *finals], ("r0",), synthetic.DEFAULT, objective, confirmed=range(6, 10)
    )
    assert after is not None and after.values == A
    assert [(g.values, g.pairs) for g in after.confirmation] == [(A, 2)]
    assert after.confirmation[0].gain == pytest.approx(0.55)


def test_campaign_ends_in_a_confirmation_and_resumes_into_it(tmp_path: Path) -> None:
    campaign = Campaign.create(tmp_path / "whole", settings())
    summary = campaign.run(InProcessExecutor())
    trials = campaign.trials()
    assert campaign.settings.search_budget == 8 and len(trials) == 14
    assert {t.why["phase"] for t in trials[:8]} == {"default", "initial design"}
    assert all(t.why["phase"] == "confirmation" and t.replicate >= 2 for t in trials[8:])
    slots = [(t.rock, t.replicate) for t in trials[8:]]
    assert slots == [("a", 2)] * 3 + [("b", 2)] * 3
    default = campaign.settings.default_values()
    assert [t.values for t in trials[8:11]] == [t.values for t in trials[11:]] and trials[
        10
    ].values == default
    best = summary.recommendation
    assert best is not None and best.values in [t.values for t in trials[8:]]
    assert len(best.confirmation) == 2 and all(g.pairs == 2 for g in best.confirmation)

    def interrupt(event: CampaignEvent) -> None:
        if event.kind == "finished" and event.finished == 10:
            os.kill(os.getpid(), signal.SIGINT)

    parts = Campaign.create(tmp_path / "parts", settings())
    assert parts.run(InProcessExecutor(), interrupt).stopped == "interrupted"
    resumed = Campaign.open(tmp_path / "parts", settings())
    assert resumed.run(InProcessExecutor()).stopped == "budget"
    key = [(t.values, t.rock, t.replicate) for t in trials]
    assert [(t.values, t.rock, t.replicate) for t in resumed.trials()] == key


def test_finalists_wait_for_the_search_to_end(tmp_path: Path) -> None:
    """With two workers the plan is the same as with one: it is made when the last search mission is in."""
    campaign = Campaign.create(tmp_path / "run", settings(rocks=("a", "slow-b")))
    order: list[tuple[str, int]] = []

    def note(event: CampaignEvent) -> None:
        if event.trial is not None and event.kind in ("launched", "finished"):
            order.append((event.kind, event.trial.number))

    with LocalProcessExecutor(2, 60.0, preload=("fake_missions",)) as executor:
        campaign.run(executor, note)
    searched = max(i for i, (kind, number) in enumerate(order) if kind == "finished" and number < 8)
    confirming = min(i for i, (kind, number) in enumerate(order) if kind == "launched" and number >= 8)
    assert searched < confirming


def test_campaign_whose_search_failed_goes_on_searching(tmp_path: Path) -> None:
    campaign = Campaign.create(tmp_path / "run", settings(rocks=("fail",), budget=6, confirmation=0.5))
    summary = campaign.run(InProcessExecutor())
    assert summary.stopped == "budget" and summary.recommendation is None
    assert all(t.why["sampler"] == "sobol" for t in campaign.trials())


def test_settings_from_before_and_shares_that_make_no_sense() -> None:
    tree = settings(confirmation=0.0).to_dict()
    del tree["confirmation"]
    assert CampaignSettings.from_dict(tree, "x.yaml").confirmation == 0.0
    with pytest.raises(UserError, match=r"give 0 to 0\.5"):
        settings(confirmation=0.6)
    with pytest.raises(UserError, match="confirms nothing"):
        settings(confirmation=0.05)
