"""Missions of a mission file, flown: whose failure it is, what is flown again, what is measured."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
import yaml

from nbv.errors import MissionFailure, UserError
from nbv.evaluation import Evaluation
from tuner.missions import LocalProcessExecutor, MissionJob
from tuner.missions.external import external_config, load_mission_file
from tuner.missions.external.flight import run_external_mission
from tuner.missions.external.process import marked
from tuner.missions.external.rehearsal import rehearse
from tuner.missions.external.scoring import score_cloud

FLY = """
import json, os, pathlib, signal, time
OK = {"schema": "gatetune.result/1", "status": "ok", "metrics": {"loss": 0.5}, "cost": {"fuel": 3}}
def leave(text):
    pathlib.Path(os.environ["GATETUNE_RESULT"]).write_text(text)
def failed(of):
    return json.dumps({"schema": "gatetune.result/1", "status": "failed", "failure": {"of": of, "reason": "tipped_over"}})
way = os.environ["GATETUNE_INSTANCE"]
first = not os.path.exists("flown")
open("flown", "w").close()
if way == "fine": leave(json.dumps(OK))
if way == "half": leave('{"schema": "gatetune.res')
if way == "nan": leave(json.dumps({**OK, "metrics": {"loss": float("nan")}}))
if way == "newer": leave(json.dumps({**OK, "schema": "gatetune.result/2"}))
if way == "killed": os.kill(os.getpid(), signal.SIGKILL)
if way in ("machine", "configuration"): leave(failed(way))
if way == "once": leave(failed("machine") if first else json.dumps(OK))
if way == "slow-once": time.sleep(1.5 if first else 0.1); leave(json.dumps(OK))
if way == "hangs": time.sleep(60)
if way == "hangs-done": leave(json.dumps(OK)); time.sleep(60)
if way == "cross": leave(json.dumps(OK)); raise SystemExit(3)
"""
WAYS = ["fine", "half", "nan", "newer", "killed", "machine", "configuration", "once", "hangs", "hangs-done"]
FILE = {
    "schema": "gatetune.mission/1",
    "name": "toy",
    "command": [sys.executable, "-S", "fly.py"],
    "parameters": {"gain": {"kind": "float", "low": 0, "high": 4, "default": 1}},
    "instances": [*WAYS, "nothing", "cross"],
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 20,
    "stop_grace_s": 0.2,
    "resources": {"PORT": {"kind": "port", "first": 5760}},
}


def mission_file(folder, **changes):
    (folder / "fly.py").write_text(FLY)
    (folder / "mission.yaml").write_text(
        yaml.safe_dump({k: v for k, v in {**FILE, **changes}.items() if v is not None})
    )
    return load_mission_file(folder / "mission.yaml")


def fly(folder, way, **changes):
    return run_external_mission(external_config(mission_file(folder, **changes)), way, 0, folder / "m")


def test_a_result_becomes_a_mission(tmp_path):
    result = fly(tmp_path, "fine")
    assert (result.status, result.metrics, result.costs["fuel"]) == ("ok", {"loss": 0.5}, 3.0)
    request = json.loads((tmp_path / "m/output/request.json").read_text())
    assert request["configuration"] == {"gain": 1.0} and request["resources"] == {"PORT": 5760}


@pytest.mark.parametrize(
    ("way", "says"),
    [
        ("nothing", "no result.json; ended with status 0"),
        ("half", "is not valid JSON"),
        ("nan", "holds NaN"),
        ("newer", "this version reads"),
        ("killed", "ended by SIGKILL"),
        ("machine", None),
    ],
)
def test_failures_of_the_machine_say_nothing_of_a_mission(tmp_path, way, says):
    with pytest.raises(MissionFailure, match=says) as failure:
        fly(tmp_path, way)
    assert failure.value.reason.startswith("machine_error: ") and "\n" not in failure.value.message


def test_a_failure_of_the_configuration_is_an_outcome(tmp_path):
    result = fly(tmp_path, "configuration")
    assert (result.status, result.reason, result.metrics) == ("failed", "tipped_over", {})


def test_a_time_out_is_the_configurations(tmp_path):
    result = fly(tmp_path, "hangs", time_limit_s=0.4)
    assert (result.status, result.reason) == ("failed", "timeout")


def test_a_result_counts_whatever_comes_after_it(tmp_path):
    assert fly(tmp_path, "hangs-done", time_limit_s=0.4).metrics == {"loss": 0.5}
    assert fly(tmp_path, "cross").status == "degraded"


def test_a_command_that_is_not_there_stops_all(tmp_path):
    with pytest.raises(UserError, match="cannot run 'no-such-program'"):
        fly(tmp_path, "fine", command=["no-such-program"])


def test_a_changed_mission_file_is_not_flown(tmp_path):
    config = external_config(mission_file(tmp_path))
    (tmp_path / "mission.yaml").write_text((tmp_path / "mission.yaml").read_text() + "\n# changed\n")
    with pytest.raises(UserError, match="has changed since the campaign began"):
        run_external_mission(config, "fine", 0, tmp_path / "m")


def test_what_the_machine_ends_is_flown_again_as_often_as_asked(tmp_path):
    config = external_config(mission_file(tmp_path))
    job = MissionJob("1", config, "once", 0, tmp_path / "1", fidelity="external")
    again = MissionJob("2", config, "machine", 0, tmp_path / "2", fidelity="external")
    with LocalProcessExecutor(1, 30.0, ("external",), max_attempts=2) as executor:
        found = {}
        for each in (job, again):
            executor.submit(each)
            while each.id not in found:
                found |= {outcome.job_id: outcome for outcome in executor.wait_any(1.0)}
    assert (found["1"].status, found["1"].metrics) == ("ok", {"loss": 0.5})
    assert found["2"].infrastructure_failure and found["2"].reason == "machine_error: tipped_over"


FINE = '{"schema": "gatetune.result/1", "status": "ok", "metrics": {"loss": 1}}'


def by_shell(folder, script, **changes):
    return fly(
        folder,
        "fine",
        command=["sh", "-c", script.replace("FINE", f"echo '{FINE}' > $GATETUNE_RESULT")],
        **changes,
    )


def test_what_a_link_in_place_of_the_output_leads_to_is_kept(tmp_path):
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious/file").write_text("mine")
    script = 'P=$PWD/precious; cd "$GATETUNE_OUTPUT/.." && rm -r output && ln -s "$P" output; FINE'
    for _ in range(2):  # the second attempt meets the link
        with pytest.raises(MissionFailure, match="removed or replaced its output folder") as failure:
            by_shell(tmp_path, script)
        assert failure.value.reason == "machine_error: output_replaced"
    assert (tmp_path / "precious/file").read_text() == "mine"


@pytest.mark.parametrize(
    ("script", "says"),
    [
        ("rm $GATETUNE_OUTPUT/mission.log; exit 1", "no result.json; ended with status 1; see"),
        ("rm -r $GATETUNE_OUTPUT", "removed or replaced its output folder"),
        ("ln -sf /dev/zero $GATETUNE_OUTPUT/mission.log", "no result.json; ended with status 0; see"),
        ("""echo '{"schema": "gatetune.result/1", "status": "ok", "metrics": {"loss": 1}, "artefacts": {"x": ""}}' """
         "> $GATETUNE_RESULT", "x is '', no file"),
        ("chmod 0 $GATETUNE_OUTPUT; exit 1", "ended with status 1"),
    ],
)  # fmt: off
def test_slips_of_a_program_are_not_the_configurations(tmp_path, script, says):
    with pytest.raises(MissionFailure, match=says) as failure:
        by_shell(tmp_path, script)
    assert failure.value.reason.startswith("machine_error: ")


def test_a_pipe_in_place_of_log_or_result_hangs_nothing(tmp_path):
    for name in ("mission.log", "result.json"):
        with pytest.raises(MissionFailure, match=r"result\.json") as failure:
            by_shell(tmp_path, f"cd $GATETUNE_OUTPUT; rm -f {name}; mkfifo {name}")
        assert failure.value.reason == "machine_error: no_result"


def test_a_huge_result_is_not_read(tmp_path):
    with pytest.raises(MissionFailure, match=r"the size of .*result\.json in bytes is 2.1\d*e\+10"):
        by_shell(tmp_path, "truncate -s 20G $GATETUNE_RESULT")


def test_what_a_link_in_place_of_the_mission_leads_to_is_kept(tmp_path):
    (tmp_path / "precious/output").mkdir(parents=True)
    (tmp_path / "precious/output/file").write_text("mine")
    script = 'P=$PWD/precious; cd "$GATETUNE_OUTPUT/../.." && mv m gone && ln -s "$P" m; FINE'
    for _ in range(2):
        with pytest.raises(MissionFailure, match="removed or replaced its output folder"):
            by_shell(tmp_path, script)
        assert not (tmp_path / "m").is_symlink()
        shutil.rmtree(tmp_path / "gone")
    (tmp_path / "m").rmdir()
    (tmp_path / "m").symlink_to("precious")  # a killed attempt left it
    assert by_shell(tmp_path, "FINE").status == "ok"
    assert (tmp_path / "precious/output/file").read_text() == "mine"


def test_artefacts_are_kept_however_they_are_named(tmp_path):
    script = """cd $GATETUNE_OUTPUT; mkdir a b; touch a/1 b/2 3 4 gone; ln -s 3 link
        echo '{"schema": "gatetune.result/1", "status": "ok", "metrics": {"loss": 1},
        "artefacts": {"1": "a/1", "2": "a/../b/2", "3": "link", "4": "'$PWD'/4"}}' > $GATETUNE_RESULT"""
    by_shell(tmp_path, script)
    output = tmp_path / "m/output"
    assert {path.name for path in output.iterdir()} == {
        *("request.json", "result.json", "mission.log"),
        *("a", "b", "3", "4", "link"),
    }


def test_a_log_that_was_removed_spoils_no_result(tmp_path):
    assert by_shell(tmp_path, "rm $GATETUNE_OUTPUT/mission.log; FINE").metrics == {"loss": 1}


def test_nothing_outlives_a_killed_worker(tmp_path):
    code = (
        "import sys; from pathlib import Path; from tuner.missions.external.process import run_command; "
        f"run_command([sys.executable, '-S', '-c', 'import time; time.sleep(60)'], Path({str(tmp_path)!r}), {{}}, "
        f"{str(tmp_path)!r}, Path({str(tmp_path / 'log')!r}), 60.0, 0.2)"
    )
    worker = subprocess.Popen([sys.executable, "-c", code])
    _wait_until(lambda: marked(str(tmp_path)))
    os.kill(worker.pid, signal.SIGKILL)
    worker.wait()
    _wait_until(lambda: not marked(str(tmp_path)))


def _wait_until(true, limit_s=20.0):
    deadline = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_function_gets_the_request_and_returns_the_result(tmp_path):
    (tmp_path / "mine.py").write_text(
        "def fly(request):\n    return {'metrics': {'loss': request['configuration']['gain'] * 2}}\n"
    )
    assert fly(tmp_path, "fine", command=None, function="mine:fly").metrics == {"loss": 2.0}


def test_a_cloud_is_aligned_by_its_cameras_and_measured(tmp_path, monkeypatch):
    """By the evaluation of our own missions, which other tests are about."""
    seen = {}

    def evaluate(cloud, rock, config, store):
        seen.update(cloud=cloud, rock=rock, config=config)
        return Evaluation({"observable": {"f_score_48mm": 50.0}}, {}, lambda: cloud)

    monkeypatch.setattr("tuner.missions.external.scoring.evaluate_cloud", evaluate)
    trimesh.creation.icosphere(3).export(tmp_path / "ball.ply")
    rng = np.random.default_rng(0)
    points, cameras = rng.normal(size=(50, 3)), 3 * rng.normal(size=(6, 3))
    turn = trimesh.transformations.rotation_matrix(0.7, (0.2, 1.0, 0.4))[:3, :3]

    def cloud_from_world(x):
        return 0.3 * x @ turn.T + (5.0, -2.0, 1.0)

    trimesh.PointCloud(cloud_from_world(points)).export(tmp_path / "cloud.ply")
    named = {
        f"{i}": {"estimated": cloud_from_world(c).tolist(), "reported": c.tolist()}
        for i, c in enumerate(cameras)
    }
    result = {"schema": "gatetune.result/1", "status": "ok", "cloud": {"path": "cloud.ply", "cameras": named}}
    (tmp_path / "made.json").write_text(json.dumps(result))
    flown = fly(
        tmp_path,
        "a",
        instances=[{"name": "a", "mesh": "ball.ply"}],
        command=["sh", "-c", 'cp cloud.ply "$GATETUNE_OUTPUT"; cp made.json "$GATETUNE_RESULT"'],
        score={"set": {"evaluation.gt_samples": 2000}},
        metric="observable.f_score_48mm",
        direction="maximise",
    )
    assert flown.metrics == {"observable": {"f_score_48mm": 50.0}}
    # The ball of radius 1 is a rock 1.6 m tall on the ground, and the cloud is moved with it.
    np.testing.assert_allclose(seen["cloud"].points_m, 0.8 * points + (0, 0, 0.8), atol=1e-5)
    assert seen["rock"].name == "ball" and seen["config"].evaluation.gt_samples == 2000
    assert not (tmp_path / "m/output/cloud.ply").exists()  # a summary keeps what the result names


@pytest.mark.slow
def test_a_cloud_is_measured_in_the_frame_of_its_mesh(tmp_path):
    """The same cloud has the same score there as in our frame, and one elsewhere is warned about."""
    ball = trimesh.creation.icosphere(4)
    cloud = ball.sample(20_000, seed=1)

    def score(cloud, **score):
        trimesh.PointCloud(cloud).export(tmp_path / "cloud.ply")
        changes = {"score": {"set": {"evaluation.gt_samples": 2000}, **score}}
        mission = mission_file(tmp_path, instances=[{"name": "a", "mesh": "ball.ply"}], **changes)
        return score_cloud(mission, "a", tmp_path, {"path": "cloud.ply"}, None)

    ball.vertices = 5 * ball.vertices + (100, -50, 20)
    ball.export(tmp_path / "ball.ply")
    theirs, warning = score(5 * cloud + (100, -50, 20))
    ours, _ = score(0.8 * cloud + (0, 0, 0.8), frame="rock")
    assert theirs["observable"]["f_score_48mm"] > 90 and not warning
    assert theirs["observable"]["f_score_48mm"] == pytest.approx(ours["observable"]["f_score_48mm"], abs=0.5)
    _, warning = score(1.5 * cloud + (100, -50, 20))
    assert "cloud and mesh hardly overlap" in warning and "ball.ply" in warning
    with pytest.raises(MissionFailure, match="hardly overlap"):
        score(cloud)


@pytest.mark.parametrize("shell", [False, True])
def test_the_skeleton_passes_its_own_check(tmp_path, gatetune, shell):
    """It packs real measurements with xz, which is on every Debian."""
    if shutil.which("xz") is None:
        pytest.skip("xz is absent: apt install xz-utils")
    code, out, err = gatetune("mission", "init", "new", *(["--shell"] if shell else []))
    assert code == 0, err
    code, out, err = gatetune("mission", "check", "new/mission.yaml")
    assert code == 0, out + err
    verdicts = [line.split()[0] for line in out.splitlines() if ": " in line][:6]
    assert verdicts == ["ok"] * 6 and "it repeats exactly" in out
    assert gatetune("mission", "init", "new")[0] == 2


@pytest.mark.parametrize(
    ("fly", "part", "kind"),
    [
        ("return {}", "the default", "failed"),
        ("return {'metrics': {'lose': 1}}", "the default", "failed"),
        ("return {'metrics': {'loss': time.time()}}", "the same again", "warning"),
        ("return {'metrics': {'loss': 1}}", "a failure", "warning"),
        ("assert 'check' not in r; return {'metrics': {'loss': 1}}", "a failure", "failed"),
        ("subprocess.Popen(['sleep', '60']); return {'metrics': {'loss': 1}}", "clean-up", "warning"),
    ],
)
def test_the_check_finds_what_is_wrong(tmp_path, fly, part, kind):
    (tmp_path / "mine.py").write_text(f"import subprocess, time\ndef fly(r):\n    {fly}\n")
    mission = mission_file(tmp_path, command=None, function="mine:fly")
    found = {verdict.part: verdict.kind for verdict in rehearse(mission, tmp_path / "trial")}
    assert found[part] == kind and "failed" not in [k for p, k in found.items() if p != part]
    assert len(found) == 6 or found["the default"] == "failed"


def test_a_time_out_is_tried_on_a_machine_that_got_faster(tmp_path):
    mission = mission_file(tmp_path, instances=["slow-once"], stop_grace_s=5)
    found = {verdict.part: verdict.kind for verdict in rehearse(mission, tmp_path / "trial")}
    assert found["a time-out"] == "ok"
