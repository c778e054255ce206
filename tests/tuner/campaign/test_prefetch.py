"""Many workers: proposals are made ahead, in batches."""

from __future__ import annotations

from pathlib import Path

from fake_campaigns import settings

from tuner.campaign import prefetch
from tuner.campaign.begin import begin_campaign
from tuner.campaign.session import fly_campaign
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
