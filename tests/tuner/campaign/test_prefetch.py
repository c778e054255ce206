"""Many workers: proposals are made ahead, in batches."""

from __future__ import annotations

import os
from pathlib import Path

import optuna
import pytest
from fake_campaigns import settings

from nbv.errors import UserError
from tuner.campaign import prefetch
from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import fly_campaign
from tuner.campaign.storage import Journal
from tuner.missions.executors import InProcessExecutor
from tuner.missions.job import Trial


class Wide(InProcessExecutor):
    """Many workers that end one at a time."""

    capacity = 16

    def __init__(self) -> None:
        super().__init__()
        self.most = 0

    def wait_any(self, timeout_s: float) -> list[Trial]:
        self.most = max(self.most, len(self._queue))
        return super().wait_any(timeout_s)


def test_a_wide_campaign_flies_every_proposal_once(tmp_path: Path) -> None:
    campaign = begin_campaign(tmp_path, settings(budget=30, initial=10, replicates=3))
    executor = Wide()
    assert fly_campaign(campaign, executor).stopped == "budget"
    trials = campaign.trials()
    assert [t.state for t in trials] == ["complete"] * 30 and executor.most >= 4
    modelled = [t for t in trials if t.why["phase"] in ("model", "verification")]
    assert modelled and all("predicted" in t.sampler_state for t in modelled)
    keys = [tuple(t.values.values()) for t in trials if t.why["phase"] != "verification"]
    assert len(set(keys)) == len(keys)
    assert Wide.capacity >= prefetch.FROM_WORKERS


def test_what_is_written_together_is_synchronised_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, synchronised, really = tmp_path / "study.journal", [], os.fsync
    storage, other = (Journal(path) for _ in range(2))
    study = optuna.create_study(study_name="s", storage=storage)
    monkeypatch.setattr(os, "fsync", lambda file: synchronised.append(really(file)))
    optuna.load_study(study_name="s", storage=other).set_user_attr("note", "a dashboard's")
    before = path.read_bytes()
    with storage.together():
        for i in range(3):
            study.add_trial(optuna.trial.create_trial(value=i, user_attrs={"rock": "slab"}))
        assert path.read_bytes() == before and len(study.trials) == 3
    assert len(synchronised) == 2
    assert study.trials == optuna.load_study(study_name="s", storage=other).trials
    study.set_user_attr("more", 1)
    assert study.user_attrs == {"note": "a dashboard's", "more": 1}
    with pytest.raises(UserError, match="another process writes"), storage.together():
        study.set_user_attr("one", 1)
        other.set_study_user_attr(0, "two", 2)
