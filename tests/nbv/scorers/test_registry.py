"""Scorers by name: those there are, and a new one as one object and one line."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
from scoring_state import synthetic_state

from nbv.config import SCORERS, MissionConfig, Weights
from nbv.errors import UserError
from nbv.gates import make_gate
from nbv.scorers import PAPER_SCORERS, Scorer, find_scorer, rank_candidates


def test_every_name_stands_for_a_scorer_of_that_name() -> None:
    assert {name: find_scorer(name).name for name in SCORERS} == {name: name for name in SCORERS}


def test_the_papers_two_are_always_ranked_others_when_asked_for() -> None:
    state, pool = synthetic_state(400, MissionConfig())
    rankings = rank_candidates(state, pool, MissionConfig())
    assert tuple(rankings) == PAPER_SCORERS == ("covis", "b-aware")
    assert rankings["matchable"] is rankings["matchable"]
    assert tuple(rankings) == ("covis", "b-aware", "matchable")
    with pytest.raises(UserError, match="unknown scorer 'matchabel'; there are covis, b-aware, matchable"):
        rankings["matchabel"]


def test_a_new_scorer_is_one_line_and_a_gate_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("my_scorer")
    module.HIGHEST = Scorer(  # type: ignore[attr-defined]
        "highest",
        lambda terms, pool, config: pool.elevations_deg / 90.0,
        weights=lambda config: Weights(1.0, 0.0, 0.0, 0.0),
    )
    monkeypatch.setitem(sys.modules, "my_scorer", module)
    monkeypatch.setitem(SCORERS, "highest", "my_scorer:HIGHEST")
    config = MissionConfig().with_values({"gate.kind": "highest"})
    state, pool = synthetic_state(400, config)
    decision = make_gate(config).decide(state, pool, rank_candidates(state, pool, config))
    assert decision.ranking.scorer == "highest"
    assert pool.elevations_deg[decision.ranking.top] == np.max(pool.elevations_deg)
