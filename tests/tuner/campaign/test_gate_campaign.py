"""A campaign over the gate, interrupted and to its end: repeats use no budget, nothing inert is recommended, one table beside the paper's."""

import dataclasses
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
from tuner.campaign.campaign import Campaign
from tuner.campaign.simplify import known_photographs, simplified
from tuner.comparison.result import all_results
from tuner.missions.job import MissionJob, repeated
from tuner.problem.baselines import label
from tuner.problem.observations import photographs_key
from tuner.report.comparison import campaign_document

pytestmark = pytest.mark.slow

RUN = (
    "campaign run --name gate --space gate_weights_and_pool --fidelity geometric --rock slab --rock vesicular "
    "--budget 20 --compare-on arch --workers 1"
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
    assert "of 20 missions" in gatetune(folder, "campaign", "status", "runs/gate")
    kept = done[0].stat().st_mtime_ns
    printed = gatetune(folder, "campaign", "resume", "runs/gate", "--workers", "1")
    assert done[0].stat().st_mtime_ns == kept, "not run again"
    return folder, printed


def test_trials_that_repeat_photographs_use_no_budget(ended):
    trials = Campaign.open(ended[0] / "runs/gate", read_only=True).trials()
    again = repeated(trials)
    searched = [t for t in trials if t.number not in again]
    assert len(searched) == 20 and again, [t.record.metadata for t in trials]
    taken = [t.photographs_taken for t in searched]
    assert len(set(taken)) == len(taken)
    first = {t.photographs_taken: t.raw for t in searched}
    assert all(first[t.photographs_taken] == t.raw for t in trials if t.number in again)


def test_nothing_inert_is_recommended(ended):
    """Every recommended change alters a photograph of the recommendation's own trials."""
    campaign = Campaign.open(ended[0] / "runs/gate", read_only=True)
    best, s = campaign.recommended(), campaign.settings
    assert best.changed and simplified(campaign) == []
    own = [t for t in campaign.trials() if t.values == best.values]
    for path in best.changed:
        reset = {**best.values, path: best.default_values[path]}
        same = []
        for t in own:
            job = s.problem.config(reset, t.condition), t.rock, t.replicate
            trace = run_geometric_mission(*job, None, keep="summary").trace
            same.append(photographs_key(job[0], [r.chosen for r in trace]) == t.record.photographs)
        assert not all(same), path


def test_the_campaign_ends_in_one_table(ended):
    folder, printed = ended
    run = folder / "runs/gate"
    result = json.loads((run / "comparison.json").read_text())
    held_out, training = result["blocks"]
    assert (held_out["rocks"], training["rocks"]) == (["arch"], ["slab", "vesicular"])
    names = set(held_out["table"]["strategies"])
    assert {"covis", "b-aware", "hyb-h", "hyb-o", "tuned", "hyb-h-tuned-pool", "random-tuned-pool"} <= names
    assert {"random", "orbit"} <= names
    f_48 = next(row for row in held_out["table"]["rows"] if row["metric"]["label"] == "F 48")
    for name in names:
        assert label(name) in printed
        if name != "hyb-h":
            gain = f_48["cells"][name]["mean"] - f_48["cells"]["hyb-h"]["mean"]
            difference = f_48["differences"][name]["mean"]
            assert difference == pytest.approx(gain, abs=1e-9)  # all pairs are there
    assert all(len(line) <= 80 for line in printed.splitlines() if "│" not in line), printed
    page = (run / "report.html").read_text().replace("\u00a0", " ")
    assert page.index('id="use"') < page.index('id="result"')  # what to fly comes first
    for sentence in result["sentences"]:
        assert sentence.split(":")[0][:30] in page


def test_a_comparison_that_was_killed_goes_on_with_resume(ended, tmp_path):
    run = tmp_path / "gate"
    shutil.copytree(ended[0] / "runs/gate", run)
    campaign = Campaign.open(run, read_only=True)
    kept = [own.table for own in all_results(campaign, campaign.recommendation(save=False))]
    mission = next((run / "evaluation/missions/random").iterdir())
    shutil.rmtree(mission)
    (run / "comparison.json").unlink()
    gatetune(tmp_path, "campaign", "resume", "gate", "--workers", "1")
    assert mission.is_dir() and (run / "comparison.json").is_file()
    campaign = Campaign.open(run, read_only=True)
    assert [own.table for own in all_results(campaign, campaign.recommendation(save=False))] == kept


def test_what_did_not_run_earns_nothing_yet(ended, tmp_path):
    """An evaluation that ended early has no verdict on the paper's two suspects, and says so."""
    run = tmp_path / "gate"
    shutil.copytree(ended[0] / "runs/gate", run)
    for arm in ("hyb-h-tuned-pool", "tuned-paper-thresholds"):
        shutil.rmtree(run / "evaluation/missions" / arm, ignore_errors=True)
    campaign = Campaign.open(run, read_only=True)
    best = campaign.recommendation(save=False)
    found = all_results(campaign, best)
    said = " ".join(campaign_document(found, best)["sentences"])
    assert "not known yet" in said and "is shown to be one" not in said
    assert not found[0].complete


def test_a_mission_that_is_not_in_the_store_is_not_known(ended):
    campaign = Campaign.open(ended[0] / "runs/gate", read_only=True)
    config = campaign.settings.problem.config(campaign.settings.problem.default)
    job = MissionJob("1", config, "slab", 977, campaign.directory)
    assert known_photographs(job) == ""  # photogrammetric, a replicate that nobody has run
    # A plug-in's missions need not know the store.
    assert known_photographs(dataclasses.replace(job, fidelity="fake-on-rocks")) == ""


def test_a_search_without_a_plan_left_to_try_runs_nothing_when_resumed(tmp_path):
    """Four planned views: the gate never switches, so every trial takes the default's photographs."""
    run = (
        "campaign run --name few --space gate --fidelity geometric --rock boulder --budget 10 --sampler sobol "
        "--replicates 1 --workers 1 --set stop.adaptive_budget=4"
    )
    assert "no plan left to try" in " ".join(gatetune(tmp_path, *run.split()).split())
    before = len(Campaign.open(tmp_path / "runs/few", read_only=True).trials())
    resumed = " ".join(gatetune(tmp_path, "campaign", "resume", "runs/few").split())
    assert "no plan left to try" in resumed and "to run" not in resumed
    page = (tmp_path / "runs/few/report.html").read_text()
    assert "no plan left to try" in page and "Finish it" not in page
    assert len(Campaign.open(tmp_path / "runs/few", read_only=True).trials()) == before == 13
