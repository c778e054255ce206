"""Scorers by name: those there are, and a new one as one object and one line."""

from __future__ import annotations

import pytest
from scoring_state import synthetic_state

from nbv.config import SCORERS, MissionConfig
from nbv.errors import UserError
from nbv.scorers import PAPER_SCORERS, find_scorer, rank_candidates


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
