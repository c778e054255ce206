"""Ledgers that lost their end, changed code and rocks, campaigns half made."""

import dataclasses
import json
import shutil
from pathlib import Path

import fake_campaigns
import fake_missions
import pytest
from in_process import InProcessExecutor
from refusals import refused

from nbv import plugins
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.campaign import mission_problem
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.missions.job import MissionJob, load_trial
from tuner.missions.registry import FIDELITIES


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory) -> Path:
    run = tmp_path_factory.mktemp("run") / "run"
    return fake_campaigns.run(run, sampler="sobol", budget=5).directory


@pytest.fixture
def copy(evaluated, tmp_path) -> Path:
    return Path(shutil.copytree(evaluated, tmp_path / "run"))


def facts(directory: Path) -> list[tuple]:
    trials = Campaign.open(directory).trials()
    return [(t.number, t.state, t.raw, t.values, t.rock, t.replicate, t.metrics, t.reason) for t in trials]


def test_a_torn_last_record_is_healed(copy, monkeypatch):
    """What a kill or a full disk leaves of it; a resume goes on behind it."""
    monkeypatch.setattr("tuner.recommendation.choose.recommend", lambda *_, **__: {})
    sound = (copy / "study.journal").read_bytes()
    before = facts(copy)
    begin = sound.rfind(b"\n", 0, -1) + 1
    for end in (begin + 1, (begin + len(sound)) // 2, len(sound) - 1):
        (copy / "study.journal").write_bytes(sound[:end])
        run_campaign(Campaign.open(copy), InProcessExecutor())
        assert facts(copy) == before
        assert all(map(json.loads, (copy / "study.journal").read_bytes().splitlines()))


def test_a_ledger_that_is_damaged_further_up_or_has_lost_its_end_is_named(copy):
    journal = copy / "study.journal"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:3], lines[3][:9], *lines[4:]]))
    refused(r"the ledger .* is damaged", Campaign.open, copy)
    journal.write_bytes(b"".join(lines[: len(lines) // 2]))
    refused(r"knows nothing of missions/000[1-4].*its end was lost", Campaign.open, copy)


def test_the_result_of_another_mission_is_not_believed(copy):
    campaign = Campaign.open(copy)
    trial = campaign.trials()[0]
    directory = trial.record.directory
    config = campaign.settings.problem.config(trial.values)

    def job(**changes):
        fields = {"config": config, "rock": trial.rock, "replicate": trial.replicate, **changes}
        return MissionJob(id="0000", directory=directory, **fields)

    assert load_trial(job()) is not None
    assert load_trial(job(rock="b" if trial.rock == "a" else "a")) is None
    assert load_trial(job(replicate=7)) is None
    (directory / "mission.json").write_text("[1]")
    assert load_trial(job()) is None
    refused(r"mission\.json is not a mission result", MissionResult.load, directory)


def test_changed_code_is_asked_about(copy, monkeypatch):
    """Of a campaign that was killed during its last mission."""
    lines = (copy / "study.journal").read_text().splitlines(keepends=True)
    last = max(k for k, line in enumerate(lines) if json.loads(line)["op_code"] == 4)
    (copy / "study.journal").write_text("".join(lines[: last + 1]))
    monkeypatch.setattr(mission_problem, "code_of", lambda fidelity: "another")
    with pytest.raises(UserError, match=r"the code of its missions changed after trial 4.*--accept-changes"):
        run_campaign(Campaign.open(copy), InProcessExecutor())
    ended = run_campaign(Campaign.open(copy), InProcessExecutor(), accept_changes=True)
    assert ended.status.finished == 5


@pytest.mark.parametrize("put_back", [True, False])
def test_a_changed_rock_is_asked_about_and_put_back_goes_on(put_back, copy, monkeypatch):
    """A mission in flight that was run on the changed mesh is run again."""
    content = ["1" * 64]

    def on_mesh(*arguments, **options):
        evaluated = fake_missions.fake_mission(*arguments, **options)
        return dataclasses.replace(evaluated, provenance={"rock_sha256": content[0]})

    fidelity = dataclasses.replace(FIDELITIES.plugin("fake"), part=on_mesh)
    monkeypatch.setitem(plugins._registered, ("fidelities", "fake"), fidelity)
    directory = copy.parent / "meshes"
    begin_campaign(directory, fake_campaigns.settings(sampler="sobol", budget=7))

    def finished(on_event=None, **options):
        campaign = Campaign.open(directory)
        return run_campaign(campaign, InProcessExecutor(), on_event, **options).status.finished

    assert finished(fake_campaigns.stop_after(3)) == 3
    content[0] = "2" * 64
    for _ in range(2):
        refused("is another one since trial", finished)
    if put_back:
        content[0] = "1" * 64
    assert finished(accept_changes=not put_back) == 7


@pytest.mark.parametrize(
    "at",
    ["tuner.campaign.ledger.Ledger", "tuner.campaign.begin.write_settings", "optuna.Study.set_user_attr"],
)
def test_a_campaign_killed_while_it_is_made_goes_on(at, tmp_path, monkeypatch):
    asked, directory = fake_campaigns.settings(sampler="sobol", budget=2), tmp_path / "run"

    def die(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(at, die)
        with pytest.raises(KeyboardInterrupt):
            begin_campaign(directory, asked)
    (directory / ".campaign.yaml.1.tmp").touch()
    begun = (directory / "campaign.yaml").is_file()
    campaign = Campaign.open(directory) if begun else begin_campaign(directory, asked)
    assert run_campaign(campaign, InProcessExecutor()).status.complete == 2
