"""Campaigns for the fewest photographs of a quality, and for the best quality of so many photographs."""

import functools
from pathlib import Path
from typing import Any

import fake_campaigns
import optuna
import pytest

from tuner.campaign.campaign import Campaign
from tuner.problem.goal import Objective
from tuner.problem.space_files import load_search_space, space_from_dict

PHOTOGRAPHS, QUALITY = Objective("costs.images", "minimise"), Objective()
SPACE = space_from_dict(
    {
        "name": "photographs",
        "base": load_search_space("photographs").base,
        "parameters": {
            "photographs": {"kind": "int", "low": 10, "high": 40, "default": 32},
            "seeds": {"kind": "int", "low": 8, "high": 24, "default": 24},
            "gate.budget_fraction": {"low": 0.0, "high": 1.0},
        },
    },
    "test",
)
LEAST = 0.3
run = functools.partial(fake_campaigns.run, space=SPACE, replicates=2)


def count(values: Any) -> float:
    return float(values["photographs"])


@pytest.fixture(scope="module")
def fewest(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """photographs@f_score>=0.3"""
    where = tmp_path_factory.mktemp("c") / "run"
    return run(where, objective=PHOTOGRAPHS, second=QUALITY, limit=LEAST, budget=16, seed=0)


def test_the_fewest_photographs_keep_the_limit_and_beat_the_default(fewest: Campaign) -> None:
    best = fewest.recommendation()
    assert best is not None and best.limit is not None and best.limit.satisfied
    assert best.mean == count(best.values)
    assert best.default_mean == 32.0
    assert best.improvement == 32.0 - best.mean > 0
    assert best.values in [t.values for t in fewest.trials()]  # run


def test_optunas_best_trial_keeps_the_limit(fewest: Campaign) -> None:
    """Without constraints the best is the mission with the fewest photographs, the worst of all models."""
    storage = optuna.storages.JournalStorage(
        optuna.storages.journal.JournalFileBackend(str(fewest.directory / "study.journal"))
    )
    study = optuna.load_study(study_name=fewest.settings.name, storage=storage)
    kept = [t for t in fewest.trials() if t.second is not None and t.second >= LEAST]
    assert 0 < len(kept) < len(fewest.trials())
    assert study.best_value == min(t.raw for t in kept if t.raw is not None)
    assert all(
        list(trial.constraints.values()) == [pytest.approx(LEAST - mission.second)]
        for trial, mission in zip(study.trials, fewest.trials(), strict=True)
        if mission.second is not None
    )


def test_the_best_of_so_many_photographs_has_no_more(tmp_path: Path) -> None:
    campaign = run(tmp_path / "run", second=PHOTOGRAPHS, limit=24.0, budget=16)
    best = campaign.recommendation()
    assert best is not None and best.limit is not None and best.limit.satisfied
    assert count(best.values) <= 24.0
