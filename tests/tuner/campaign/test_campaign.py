import collections
import functools
import itertools
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import fake_campaigns
import numpy as np
import psutil
import pytest
import yaml
from in_process import InProcessExecutor
from refusals import refused

from tuner.campaign.begin import begin_campaign, extend_campaign
from tuner.campaign.campaign import Campaign, CampaignEvent
from tuner.campaign.session import run_campaign
from tuner.cli import app
from tuner.missions.job import Trial
from tuner.missions.pool import MissionPool
from tuner.problem.goal import Objective
from tuner.problem.space_files import load_search_space, space_from_dict
from tuner.report import write_campaign_report

settings = functools.partial(
    fake_campaigns.settings, space=load_search_space("gate"), budget=6, sampler="sobol"
)
run = functools.partial(fake_campaigns.run, space=load_search_space("gate"), budget=6, sampler="sobol")


def workers(count: int = 1, timeout_s: float = 60.0) -> MissionPool:
    return MissionPool(count, timeout_s, fidelity="fake")


def facts(campaign: Campaign) -> list[tuple]:
    return [(t.number, t.rock, t.replicate, t.values, t.raw) for t in campaign.trials()]


@pytest.mark.slow
def test_interrupted_campaign_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    changes: dict[str, object] = {"sampler": "gp", "budget": 7, "initial": 4}
    whole = run(tmp_path / "whole", **changes)
    handler = signal.getsignal(signal.SIGINT)

    campaign = begin_campaign(tmp_path / "parts", settings(**changes))
    summary = run_campaign(campaign, InProcessExecutor(), fake_campaigns.stop_after(5))
    assert summary.stopped == "interrupted" and summary.status.finished == 5
    assert signal.getsignal(signal.SIGINT) is handler
    resumed = Campaign.open(tmp_path / "parts", settings(**changes))
    assert run_campaign(resumed, InProcessExecutor()).stopped == "budget"
    assert [t.number for t in resumed.trials()] == list(range(7))
    for a, b in zip(whole.trials(), resumed.trials()):
        np.testing.assert_allclose(list(a.values.values()), list(b.values.values()), rtol=1e-6)


@pytest.mark.slow
def test_in_step_a_campaign_is_the_same_with_any_workers(tmp_path: Path) -> None:
    changes: dict[str, object] = {"sampler": "gp", "initial": 4, "rocks": ("slow", "b"), "in_step": 3}
    alone = run(tmp_path / "alone", **changes)
    side_by_side = begin_campaign(tmp_path / "four", settings(**changes))
    with workers(4) as executor:
        assert run_campaign(side_by_side, executor).stopped == "budget"
    assert facts(alone) == facts(side_by_side) and len(alone.trials()) == 6


DRIVER = """
import sys
import fake_missions
from pathlib import Path
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.missions.pool import MissionPool
if __name__ == "__main__":
    campaign = Campaign.open(Path(sys.argv[1]))
    with MissionPool(2, 60.0, fidelity="fake") as executor:
        run_campaign(campaign, executor, lambda event: print(event.kind, flush=True))
"""


@pytest.mark.slow
def test_kill_9_loses_and_doubles_nothing(tmp_path: Path) -> None:
    directory = tmp_path / "run"
    campaign = begin_campaign(directory, settings(rocks=("slow-a", "slow-b"), budget=12, replicates=2))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", DRIVER, str(directory)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        kinds = itertools.accumulate(line == "finished\n" for line in process.stdout)
        assert any(finished == 3 for finished in kinds)
        below = psutil.Process(process.pid).children(recursive=True)
        process.kill()
    assert below and not psutil.wait_procs(below, timeout=10)[1]  # no mission outlives its campaign
    # The worst a kill can leave: a half-written record and a lock nobody holds.
    with (directory / "study.journal").open("ab") as file:
        file.write(b'{"op_code":4,"worker')
    lock = directory / "study.journal.lock"
    lock.unlink(missing_ok=True)
    lock.symlink_to(directory / "study.journal")

    resumed = Campaign.open(directory, campaign.settings)
    before = {t.number: t for t in resumed.trials()}
    finished_before = [n for n, t in before.items() if t.state != "running"]
    assert 1 <= len(finished_before) < 12
    with workers(2) as executor:
        summary = run_campaign(resumed, executor)
    assert summary.stopped == "budget" and summary.status.complete == summary.status.budget
    after = Campaign.open(directory, read_only=True).trials()
    assert [t.number for t in after] in (list(range(12)), list(range(13)))  # a favourite may fly behind it
    blocks = collections.Counter((t.rock, t.replicate) for t in after[:12])
    assert blocks == dict.fromkeys(itertools.product(("slow-a", "slow-b"), (0, 1)), 3)
    for number, t in before.items():
        assert (after[number].values, after[number].rock) == (t.values, t.rock)
    for number in finished_before:  # what was told stays as it was and is not run again
        assert after[number] == before[number]
        assert (after[number].record.directory / "run.txt").read_text() == "run\n"


@pytest.mark.parametrize("sampler", ["sobol", "gp"])
def test_a_proposal_that_the_configuration_refuses_is_infeasible(sampler, tmp_path, monkeypatch):
    """The lower angle may not be above the upper one: some points of the space are no mission."""
    low, high = {"low": 0, "high": 24}, {"low": 6, "high": 26}
    angles = {"b_aware.theta_low_deg": low, "b_aware.theta_saturation_deg": high}
    space = space_from_dict({"name": "angles", "parameters": angles}, "test")
    asked = settings(space=space, sampler=sampler, budget=14, initial=10)
    campaign = begin_campaign(tmp_path / "run", asked)

    def die(*_: object) -> Trial:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:  # killed before the refusal is in the ledger
        patch.setattr("tuner.campaign.session._Session._refuse", die)
        with pytest.raises(KeyboardInterrupt):
            run_campaign(campaign, InProcessExecutor())
    # It counts missions that ran.
    monkeypatch.setattr("tuner.campaign.session.MAX_CONSECUTIVE_FAILURES", 1)
    events: list[CampaignEvent] = []
    resumed = Campaign.open(tmp_path / "run")
    assert run_campaign(resumed, InProcessExecutor(), events.append).stopped == "budget"
    refused = [t for t in resumed.trials() if t.state == "failed"]
    assert 1 <= len(refused) < 8 and {t.reason for t in refused} == {"configuration_refused"}
    behind = sampler == "gp"  # a favourite flies behind the budget
    assert asked.budget <= len(resumed.trials()) <= asked.budget + behind  # of which they are part
    assert all("theta_low_deg" in t.record.message and "\n" not in t.record.message for t in refused)
    assert not any(t.record.directory.exists() for t in refused)
    assert [e.message for e in events if e.kind == "failed"] == [t.record.message for t in refused]
    found = resumed.recommendation()
    assert found is not None and found.failures == len(refused)
    assert "configuration_refused" in write_campaign_report(resumed).read_text()


def test_what_the_machine_ended_is_neither_counted_nor_learned(tmp_path, monkeypatch):
    monkeypatch.setattr("tuner.missions.job.MAX_ATTEMPTS", 1)
    campaign = begin_campaign(tmp_path / "run", settings(rocks=("a", "once-full"), budget=4))
    summary = run_campaign(campaign, InProcessExecutor())
    assert summary.stopped == "failing" and "2 missions were ended by the machine" in summary.message
    assert "disk_full" in summary.message
    assert [(t.rock, t.state) for t in campaign.trials()] == [("a", "complete"), ("once-full", "running")] * 2
    assert {o.rock for o in campaign.history()} == {"a"}
    summary = run_campaign(Campaign.open(tmp_path / "run"), InProcessExecutor())
    assert summary.stopped == "budget" and summary.status.complete == 4  # the machine has been mended


def test_missing_metric_is_a_failure_not_a_zero(tmp_path: Path) -> None:
    campaign = run(tmp_path / "run", objective=Objective("observable.no_such"), budget=2)
    assert {t.reason for t in campaign.trials()} == {"metric_missing: observable.no_such"}


def test_directories_of_others_are_left_alone(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("years of work")
    refused("not an empty directory", begin_campaign, foreign, settings())
    assert [p.name for p in foreign.iterdir()] == ["thesis.tex"]

    run(tmp_path / "run", budget=2)
    journal = tmp_path / "run" / "study.journal"
    before = journal.read_bytes()
    refused(r"already holds this campaign.*resume", begin_campaign, tmp_path / "run", settings(budget=2))
    refused("already holds another campaign", begin_campaign, tmp_path / "run", settings(budget=3))
    refused("seed is 1 there, not 7", Campaign.open, tmp_path / "run", settings(budget=2, seed=7))
    refused("holds no campaign", Campaign.open, tmp_path / "nothing")
    assert journal.read_bytes() == before
    journal.unlink()
    refused(r"ledger .* is missing", Campaign.open, tmp_path / "run")
    refused("cannot write", begin_campaign, foreign / "thesis.tex" / "run", settings())


def test_one_campaign_runs_once_at_a_time(tmp_path: Path) -> None:
    campaign = begin_campaign(tmp_path / "run", settings(budget=2))

    def intrude(event: CampaignEvent) -> None:
        if event.kind == "launched":
            refused("in use by another process", Campaign.open, tmp_path / "run")
            assert Campaign.open(tmp_path / "run", read_only=True).status().budget == 2

    assert run_campaign(campaign, InProcessExecutor(), intrude).stopped == "budget"


def test_what_a_campaign_ended_with_stands_until_missions_come(tmp_path: Path) -> None:
    """An upgraded surrogate may prefer another configuration; an evaluation under way must not change its mind."""
    campaign = run(tmp_path / "run", budget=6)
    path = tmp_path / "run" / "recommendation.json"
    saved = json.loads(path.read_text())["tuned-gate"]
    other = next(t.values for t in campaign.trials() if t.values != saved["values"])
    left_out = {"mission": 0, "measured": 0.0, "counts_as": None}
    for current in ({}, {"observations": 5, "outliers": [left_out]}):
        path.write_text(json.dumps({"tuned-gate": {**saved, "values": other, **current}}))
        assert Campaign.open(tmp_path / "run").recommended_config() == campaign.settings.problem.config(other)
    for stale in (
        {**saved, "values": other, "observations": 5},
        {**saved, "values": {**other, "gate.d95_m": 1e9}},  # never run
        {**saved, "values": other, "sparsest": None},  # of an earlier version
        {},
    ):
        path.write_text(json.dumps({"tuned-gate": stale}))
        found = Campaign.open(tmp_path / "run").recommended_config()
        assert found == campaign.settings.problem.config(saved["values"])


@pytest.mark.parametrize("sampler", ["gp", "random"])
def test_nothing_is_said_before_the_default_has_its_replicates_on_every_rock(tmp_path, sampler, capsys):
    campaign = begin_campaign(tmp_path / "run", settings(budget=12, replicates=2, sampler=sampler))
    stop = fake_campaigns.stop_after(1)
    assert run_campaign(campaign, InProcessExecutor(), stop).status.finished == 1
    assert campaign.recommendation(save=False) is None
    app(["campaign", "status", str(campaign.directory)], standalone_mode=False)
    said = capsys.readouterr().out
    assert "Nothing to fly yet: 1 of the first" in said and "interval" not in said
    assert "Nothing to fly yet: 1 of the first" in write_campaign_report(campaign).read_text()
    run_campaign(campaign, InProcessExecutor())
    first = campaign.trials()[:2]
    assert len({(t.rock, t.replicate) for t in first}) == 2
    assert all(t.values == campaign.settings.problem.default for t in first)
    assert campaign.recommendation() is not None


@pytest.mark.slow
def test_a_finished_campaign_is_extended(tmp_path: Path) -> None:
    first = run(tmp_path / "run", budget=6, sampler="gp")
    before = facts(first)
    refused("budget of 6 missions; 6 does not extend", extend_campaign, first, 6)
    longer = extend_campaign(first, 10)
    assert longer.settings.initial_size() == first.settings.initial_size()
    summary = run_campaign(longer, InProcessExecutor())
    assert (
        summary.status.budget == summary.status.complete == len(longer.trials())
        and 10 <= len(longer.trials()) <= 11
    )
    assert facts(longer)[:6] == before
    # It is the campaign that anyone finds there, and its file says that it grew.
    assert Campaign.open(tmp_path / "run").status().remaining == 0
    tree = yaml.safe_load((tmp_path / "run" / "campaign.yaml").read_text())
    assert [(e["from"], e["to"]) for e in tree["extensions"]] == [(6, 10)]


def test_it_is_evaluated_on_targets_of_the_kinds_that_it_was_tuned_on(tmp_path: Path) -> None:
    tuned_on = {"shapes": ("part-1", "lever-0", "part-2"), "both": ("slab", "part-1"), "own": ("a",)}
    kinds = {
        name: begin_campaign(tmp_path / name, settings(rocks=rocks)).held_out()
        for name, rocks in tuned_on.items()
    }
    assert sorted(kinds["shapes"]) == [f"{kind}-2000{k}" for kind in ("lever", "part") for k in range(3)]
    assert "arch" in kinds["own"] and kinds["both"] == [*kinds["own"], *(f"part-2000{k}" for k in range(3))]
