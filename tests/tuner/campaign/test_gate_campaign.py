"""A campaign over the gate, interrupted and to its end: repeats use no budget, nothing inert is recommended, one table beside the paper's."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import fake_missions  # noqa: F401  registers its fidelities
import pytest

from nbv.geometric import run_geometric_mission
from tuner.answer.answer import ANSWER_FILE, answer_of
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import VERIFY, simplified
from tuner.missions.job import repeated
from tuner.problem.baselines import label
from tuner.problem.observations import photographs_key

pytestmark = pytest.mark.slow

RUN = (
    "campaign run --name gate --space gate_weights_and_pool --fidelity geometric --rock slab --rock vesicular "
    "--budget 16 --seed 1 --compare-on arch --workers 1"
)


ENVIRONMENT = os.environ | {"COLUMNS": "80"}


def gatetune(folder, *arguments):
    command = [sys.executable, "-m", "tuner.cli", *arguments]
    ended = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300, check=False, env=ENVIRONMENT
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """The folder of the campaign, which Ctrl-C ended first, and what its resume printed."""
    folder = tmp_path_factory.mktemp("gate")
    command = [sys.executable, "-m", "tuner.cli", *RUN.split()]
    first = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT)
    while not (done := list(folder.glob("runs/gate/missions/*/mission.json"))) and first.poll() is None:
        time.sleep(0.1)
    first.send_signal(signal.SIGINT)
    said, _ = first.communicate(timeout=60)
    assert first.returncode == 130 and "gatetune campaign resume" in said, said
    assert "of 16 missions" in gatetune(folder, "campaign", "status", "runs/gate")
    kept = done[0].stat().st_mtime_ns
    printed = gatetune(folder, "campaign", "resume", "runs/gate", "--workers", "1")
    assert done[0].stat().st_mtime_ns == kept, "not run again"
    return folder, printed


def test_trials_that_repeat_photographs_use_no_budget(ended):
    trials = Campaign.open(ended[0] / "runs/gate", read_only=True).trials()
    again = repeated(trials)
    searched = [t for t in trials if t.number not in again]
    assert 16 <= len(searched) <= 16 + 16 // VERIFY and again, [t.record.metadata for t in trials]
    taken = [t.photographs_taken for t in searched]
    assert len(set(taken)) == len(taken)
    first = {t.photographs_taken: t.raw for t in searched}
    assert all(first[t.photographs_taken] == t.raw for t in trials if t.number in again)


def test_nothing_inert_is_recommended(ended):
    """Every recommended change alters a photograph of the recommendation's own trials."""
    campaign = Campaign.open(ended[0] / "runs/gate", read_only=True)
    s = campaign.settings
    assert simplified(campaign, {}) == []
    for best in campaign.recommended().values():
        own = [t for t in campaign.trials() if t.values == best.values]
        for path in best.changed:
            reset = {**best.values, path: best.default_values[path]}
            same = []
            for t in own:
                job = s.problem.config(reset, t.condition), t.rock, t.replicate
                trace = run_geometric_mission(*job, None, keep="summary").trace
                same.append(photographs_key(job[0], [r.chosen for r in trace]) == t.record.photographs)
            assert not all(same), path


def test_photographs_taken_with_other_idle_values_count_for_the_recommended(ended):
    campaign = Campaign.open(ended[0] / "runs/gate", read_only=True)
    trials = campaign.trials()
    taken = {(t.rock, t.replicate, t.record.photographs) for t in trials}
    for best in campaign.recommended().values():
        own = {(t.rock, t.replicate) for t in trials if t.values == best.values}
        config = campaign.settings.problem.config(best.values, trials[0].condition)
        for rock, k in {(t.rock, t.replicate) for t in trials} - own:
            trace = run_geometric_mission(config, rock, k, None, keep="summary").trace
            assert (rock, k, photographs_key(config, [r.chosen for r in trace])) not in taken


def test_the_campaign_ends_in_one_table(ended):
    folder, printed = ended
    run = folder / "runs/gate"
    answer = json.loads((run / ANSWER_FILE).read_text())
    held_out, training = answer["tables"]
    assert (held_out["targets"], training["targets"]) == (["arch"], ["slab", "vesicular"])
    rows = {row["strategy"]: row for row in held_out["rows"]}
    assert {"covis", "b-aware", "hyb-h", "hyb-o", "tuned-gate", "tuned-planner", "random", "orbit"} <= set(
        rows
    )
    for name, row in rows.items():
        assert label(name) in printed
        if name != "hyb-h":
            gain = row["means"]["all"] - rows["hyb-h"]["means"]["all"]
            assert row["from_reference"]["mean"] == pytest.approx(gain, abs=1e-9)  # all pairs are there
    # Missions that planned views, without those that repeat the photographs of an earlier one.
    trials = Campaign.open(run, read_only=True).trials()
    planned = {t.photographs_taken for t in trials if t.record.switched is not None}
    assert {gate["all_missions"] for gate in answer["gates"].values()} == {len(planned)}
    assert all(len(line) <= 80 for line in printed.splitlines() if "│" not in line), printed
    page = (run / "report.html").read_text().replace("\u00a0", " ")
    assert page.index('id="use"') < page.index('id="result"')  # what to fly comes first
    assert label(answer["fly"]["strategy"]).lower()[-9:] in page.lower()


def test_a_comparison_that_was_killed_goes_on_with_resume(ended, tmp_path):
    run = tmp_path / "gate"
    shutil.copytree(ended[0] / "runs/gate", run)
    kept = answer_of(Campaign.open(run, read_only=True)).tables
    mission = next((run / "evaluation/missions/random").iterdir())
    shutil.rmtree(mission)
    (run / ANSWER_FILE).unlink()
    gatetune(tmp_path, "campaign", "resume", "gate", "--workers", "1")
    assert mission.is_dir() and (run / ANSWER_FILE).is_file()
    assert answer_of(Campaign.open(run, read_only=True)).tables == kept


def test_a_search_without_a_plan_left_to_try_runs_nothing_when_resumed(tmp_path):
    """Four planned views: the gate never switches, so every trial takes the default's photographs."""
    run = (
        "campaign run --name few --space gate --fidelity geometric --rock boulder --budget 10 --sampler sobol "
        "--replicates 1 --workers 1 --set photographs=28"
    )
    assert "no plan left to try" in " ".join(gatetune(tmp_path, *run.split()).split())
    before = len(Campaign.open(tmp_path / "runs/few", read_only=True).trials())
    resumed = " ".join(gatetune(tmp_path, "campaign", "resume", "runs/few").split())
    assert "no plan left to try" in resumed and "to run" not in resumed
    page = (tmp_path / "runs/few/report.html").read_text()
    assert "no plan left to try" in page and "Finish it" not in page
    assert len(Campaign.open(tmp_path / "runs/few", read_only=True).trials()) == before == 13
