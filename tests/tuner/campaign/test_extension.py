"""A campaign's budget grows: nothing flown is lost or flown again, and the file says so."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from fake_campaigns import FIDELITY
from test_campaign import run

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.extension import extend_campaign
from tuner.campaign.session import fly_campaign
from tuner.missions.executors import InProcessExecutor


@pytest.mark.slow
def test_a_finished_campaign_is_extended(tmp_path: Path) -> None:
    first = run(tmp_path / "run", budget=6, sampler="gp")
    before = [(t.number, t.rock, t.replicate, t.values, t.raw) for t in first.trials()]
    with pytest.raises(UserError, match="budget of 6 missions; 6 does not extend"):
        extend_campaign(tmp_path / "run", 6, FIDELITY)
    longer = extend_campaign(tmp_path / "run", 10, FIDELITY)
    assert longer.settings.initial_size() == first.settings.initial_size()
    summary = fly_campaign(longer, InProcessExecutor())
    assert (summary.status.budget, summary.status.complete) == (10, 10)
    after = [(t.number, t.rock, t.replicate, t.values, t.raw) for t in longer.trials()]
    assert after[:6] == before and len(after) == 10
    # It is the campaign that anyone finds there, and its file says that it grew.
    assert Campaign.open(tmp_path / "run", fidelity=FIDELITY).status().remaining == 0
    tree = yaml.safe_load((tmp_path / "run" / "campaign.yaml").read_text())
    assert [(e["from"], e["to"]) for e in tree["extensions"]] == [(6, 10)]
