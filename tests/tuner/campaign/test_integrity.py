"""Ledgers that lost their end, changed code and rocks, campaigns half made; and many workers."""

import dataclasses
import json
import queue
import shutil
import time
from concurrent.futures import Future
from pathlib import Path

import fake_campaigns
import fake_missions
import pytest
from fake_campaigns import settings
from fake_missions import fake_mission
from in_process import InProcessExecutor
from refusals import refused

from nbv import plugins
from nbv.errors import UserError
from nbv.mission.result import MissionResult
from tuner.campaign import mission_problem
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import run_campaign
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor
from tuner.missions.registry import FIDELITIES
from tuner.problem.space_files import load_search_space


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
    monkeypatch.setattr("tuner.recommendation.choose.recommend", lambda *_, **__: None)
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


WORKERS, MISSION_S, BUDGET = 512, 20.0, 1536


class SimulatedWorkers(Executor):
    """Missions take no time to compute; each ends `MISSION_S` after its start on a clock of what the coordinator computes."""

    capacity = WORKERS

    def __init__(self) -> None:
        super().__init__(60.0)
        self._jumped_s = self._missions_s = 0.0
        self._ends: dict[Future[Trial], tuple[float, MissionJob]] = {}
        self.starts: list[float] = []

    @property
    def now(self) -> float:
        return time.process_time() - self._missions_s + self._jumped_s

    def submit(self, job: MissionJob) -> Future[Trial]:
        future: Future[Trial] = Future()
        self.starts.append(self.now)
        began = time.process_time()
        job.directory.mkdir(parents=True)
        result = fake_mission(job.config, job.rock, job.replicate, job.directory)
        (job.directory / "mission.json").write_text(result.to_json())
        self._missions_s += time.process_time() - began
        self._ends[future] = self.starts[-1] + MISSION_S, job
        return future

    def end_next(self) -> None:
        """End what has ended by now, else what ends next: the clock jumps there."""
        first = min(end for end, _ in self._ends.values())
        self._jumped_s += max(0.0, first - self.now)
        for future in [future for future, (end, _) in self._ends.items() if end <= self.now]:
            _, job = self._ends.pop(future)
            future.set_result(load_trial(job, MISSION_S))

    def close(self) -> None:
        """Nothing runs."""


@pytest.mark.slow
def test_512_workers_are_busy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = begin_campaign(
        tmp_path / "run", settings(space=load_search_space("gate"), budget=BUDGET, replicates=8)
    )
    with SimulatedWorkers() as executor:

        class Ended(queue.SimpleQueue):
            def get(self, block: bool = True, timeout: float | None = None) -> Future[Trial]:
                if block:
                    executor.end_next()
                return super().get(block=False)

        monkeypatch.setattr("tuner.missions.run_jobs.SimpleQueue", Ended)
        run_campaign(campaign, executor)
    starts = executor.starts[:BUDGET]
    took_s = starts[-1] - starts[0]
    busy_s = sum(min(MISSION_S, starts[-1] - start) for start in starts)
    share = busy_s / (WORKERS * took_s)
    assert share >= 0.55, f"{100 * share:.0f} % busy over {took_s:.0f} s"
