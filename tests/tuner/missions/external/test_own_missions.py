import json
import shutil
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
import trimesh
import yaml

from nbv.errors import MissionFailure, UserError
from nbv.evaluation import Evaluation
from tuner.missions.external import program
from tuner.missions.external.mission import run_external_mission
from tuner.missions.external.mission_file import external_config, load_mission_file

FILE = {
    "name": "toy",
    "parameters": {"gain": {"kind": "float", "low": 0, "high": 4, "default": 1}},
    "instances": ["here"],
    "metric": "loss",
    "direction": "minimise",
    "time_limit_s": 20,
}
FINE = """echo '{"metrics": {"loss": 0.5}, "costs": {"fuel": 3}}' > $GATETUNE_OUTPUT/result.json"""


def mission_file(folder, **changes):
    (folder / "mission.yaml").write_text(yaml.safe_dump({**FILE, **changes}))
    return load_mission_file(folder / "mission.yaml")


def run_missions(folder, script, **changes):
    mission = mission_file(folder, command=["sh", "-c", script], **changes)
    instance = next(iter(mission.instances))
    return run_external_mission(external_config(mission, {}), instance, 0, folder / "m")


def test_a_result_becomes_a_mission(tmp_path):
    script = f"echo $PARAMETER_gain $GATETUNE_INSTANCE; cd $GATETUNE_OUTPUT; mkdir a; touch a/1 b; cp $0 kept; {FINE}"
    result = run_missions(tmp_path, script)
    assert (result.status, result.metrics, result.costs["fuel"]) == ("ok", {"loss": 0.5}, 3.0)
    output = tmp_path / "m/output"
    request = json.loads((output / "request.json").read_text())
    assert request["configuration"] == {"gain": 1.0} and request["instance"] == {"name": "here"}
    assert (output / "mission.log").read_text() == "1.0 here\n"
    # A summary keeps no files of the mission's own.
    assert {path.name for path in output.iterdir()} == {"request.json", "result.json", "mission.log"}


@pytest.mark.parametrize(
    ("script", "says"),
    [
        ("echo no fix; exit 3", "no result.json; it ended with status 3: 'no fix'; see .*mission.log"),
        ("kill -9 $$", "it ended with SIGKILL"),
        ("read -r password < /dev/tty || exit 1", "it ended with status 1"),
        ("""echo '{"metrics": {"lo' > $GATETUNE_OUTPUT/result.json""", "is not valid JSON: .*; it ended"),
        ("truncate -s 20G $GATETUNE_OUTPUT/result.json", r"in bytes is 2.1\d*e\+10"),
        ("mkfifo $GATETUNE_OUTPUT/result.json", "not a regular file"),
        ("rm -r $GATETUNE_OUTPUT", "no result.json"),
    ],
)
def test_failures_of_the_machine_say_nothing_of_a_mission(tmp_path, script, says):
    with pytest.raises(MissionFailure, match=says) as failure:
        run_missions(tmp_path, script)
    assert failure.value.reason == "machine_error: no_result" and "\n" not in failure.value.message


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ('{"metrics": {"loss": NaN}}', "loss is nan"),
        ('{"metrics": {"loss": 1e999}}', "loss is inf"),
        ('{"metrics": {"loss": null}}', "loss is None"),
        ('{"metrics": {"loss": 1}, "costs": {"fuel": NaN}}', "costs.fuel is nan"),
    ],
)
def test_what_is_no_number_is_the_configurations_failure(tmp_path, result, message):
    mission = run_missions(tmp_path, f"echo '{result}' > $GATETUNE_OUTPUT/result.json")
    assert (mission.status, mission.reason, mission.message) == ("failed", "metric_not_a_number", message)


def test_what_a_mission_prints_is_cut(tmp_path):
    run_missions(tmp_path, f"echo first; head -c 30000000 /dev/zero; echo last; {FINE}")
    log = (tmp_path / "m/output/mission.log").read_bytes()
    assert len(log) < 1_100_000 and log.startswith(b"first") and log.endswith(b"last\n")
    assert b"[29000011 bytes left out]" in log


def test_a_further_metric_that_is_no_number_is_left_out(tmp_path):
    text = '{"metrics": {"loss": 1, "of": {"psnr": NaN, "rmse": 2}, "note": "x"}}'
    evaluated = run_missions(tmp_path, f"echo '{text}' > $GATETUNE_OUTPUT/result.json")
    assert (evaluated.status, evaluated.metrics) == ("ok", {"loss": 1, "of": {"rmse": 2}})


def test_a_time_out_is_the_configurations_unless_there_is_a_result(tmp_path):
    result = run_missions(tmp_path, "sleep 60", time_limit_s=0.3)
    assert (result.status, result.reason) == ("failed", "timeout")
    assert run_missions(tmp_path, f"{FINE}; sleep 60", time_limit_s=0.3).metrics == {"loss": 0.5}


def test_a_changed_mission_file_or_program_is_not_flown(tmp_path):
    (tmp_path / "mine.py").write_text("")
    config = external_config(mission_file(tmp_path, function="mine:run"), {})
    (tmp_path / "mine.py").write_text("# changed")
    with pytest.raises(UserError, match=r"program of .* changed while its missions ran"):
        run_external_mission(config, "here", 1, tmp_path / "m")
    mission_file(tmp_path, function="mine:other")
    with pytest.raises(UserError, match="has changed since the campaign began"):
        run_external_mission(config, "here", 0, tmp_path / "m")


# A daemon without the environment in which it was started, in a session of its own, whose parents have ended.
DAEMON = (
    f"""env -i {sys.executable} -S -c "import os, time; os.setsid(); os.fork() and os._exit(0); """
    """open('pid', 'w').write(str(os.getpid())); time.sleep(60)"; while [ ! -s pid ]; do sleep 0.05; done; """
)


def daemon_lives(tmp_path):
    return psutil.pid_exists(int((tmp_path / "pid").read_text()))


def test_no_process_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(program, "GRACE_S", 0.2)
    assert run_missions(tmp_path, DAEMON + FINE).status == "ok"
    assert not daemon_lives(tmp_path)
    (tmp_path / "pid").unlink()
    # One that ignores SIGTERM and one that is stopped are killed.
    ended = run_missions(tmp_path, f"trap '' TERM; {DAEMON} kill -STOP $$", time_limit_s=1.5)
    assert ended.reason == "timeout"
    assert not daemon_lives(tmp_path)


@pytest.fixture
def measured(monkeypatch):
    """What is measured, by the evaluation of our own missions, which other tests are about."""
    seen = {}

    def evaluate(cloud, rock, config, store):
        seen.update(points_m=cloud.points_m, rock=rock, config=config)
        return Evaluation({"observable": {"f_score_48mm": 50.0}}, {}, lambda: cloud)

    monkeypatch.setattr("tuner.missions.external.mission.evaluate_cloud", evaluate)
    return seen


CENTRE = np.array((100.0, -50.0, 20.0))


def fly_cloud(folder, points, cameras, **score):
    """A mission that leaves ``points``, of a ball of radius 1 around `CENTRE` in its mesh file."""
    if not (folder / "ball.ply").exists():
        ball = trimesh.creation.icosphere(3)
        ball.vertices += CENTRE
        ball.export(folder / "ball.ply")
    trimesh.PointCloud(points).export(folder / "cloud.ply")
    (folder / "made.json").write_text(json.dumps({"cloud": {"path": "cloud.ply", "cameras": cameras}}))
    script = 'cp cloud.ply "$GATETUNE_OUTPUT"; cp made.json "$GATETUNE_OUTPUT/result.json"'
    score = {"set": {"evaluation.gt_samples": 2000}, **score}
    return run_missions(folder, script, instances=[{"name": "a", "mesh": "ball.ply"}], score=score)


@pytest.mark.slow
def test_a_cloud_is_moved_with_its_mesh_and_measured(tmp_path, measured):
    """The ball is measured as a rock 1.6 m tall on the ground."""
    points = trimesh.creation.icosphere(4).vertices
    evaluated = fly_cloud(tmp_path, points + CENTRE, {})
    assert (evaluated.status, evaluated.metrics) == ("ok", {"observable": {"f_score_48mm": 50.0}})
    assert evaluated.provenance["rock_sha256"] == measured["rock"].sha256
    assert measured["rock"].name == "ball" and measured["config"].evaluation.gt_samples == 2000
    np.testing.assert_allclose(measured["points_m"], 0.8 * points + (0, 0, 0.8), atol=1e-5)
    assert fly_cloud(tmp_path, 0.8 * points + (0, 0, 0.8), {}, frame="rock").status == "ok"
    np.testing.assert_allclose(measured["points_m"], 0.8 * points + (0, 0, 0.8), atol=1e-5)
    elsewhere = fly_cloud(tmp_path, points, {})
    assert (elsewhere.status, elsewhere.reason) == ("degraded", "hardly_overlap")
    assert "cloud and mesh hardly overlap" in elsewhere.message and "ball.ply" in elsewhere.message


@pytest.mark.slow
def test_a_cloud_is_aligned_by_its_cameras(tmp_path, measured):
    rng = np.random.default_rng(0)
    points, centres = trimesh.creation.icosphere(4).vertices + CENTRE, 3 * rng.normal(size=(6, 3))
    turn = trimesh.transformations.rotation_matrix(0.7, (0.2, 1.0, 0.4))[:3, :3]

    def cloud_from_world(x):
        return 0.3 * x @ turn.T + (5.0, -2.0, 1.0)

    cameras = {
        f"{i}": {"estimated": cloud_from_world(centre).tolist(), "reported": centre.tolist()}
        for i, centre in enumerate(centres)
    }
    assert fly_cloud(tmp_path, cloud_from_world(points), cameras).status == "ok"
    np.testing.assert_allclose(measured["points_m"], 0.8 * (points - CENTRE) + (0, 0, 0.8), atol=1e-4)
    few = fly_cloud(tmp_path, points, dict(list(cameras.items())[:2]))
    assert (few.status, few.reason) == ("failed", "not_aligned")


def test_the_skeleton_passes_its_own_check(gatetune):
    """It packs real measurements with xz, which is on every Debian."""
    if shutil.which("xz") is None:
        pytest.skip("xz is absent: apt install xz-utils")
    gatetune.ok("mission", "init", "new")
    assert load_mission_file(Path("new/mission.yaml")).name == "new"
    out = gatetune.ok("mission", "check", "new/mission.yaml")
    assert "packed_percent = " in out and "ready: gatetune campaign run --mission new/mission.yaml" in out
    gatetune.refused("mission", "init", "new")


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("return {}", "machine_error: no_result: result.json needs metrics, cloud or failure"),
        ("return {'metrics': {'lose': 1}}", "no_metric: it has no metric 'loss'"),
        ("return {'failure': 'tipped_over'}", "tipped_over"),
        ("raise ValueError('no such sensor')", "ValueError: no such sensor"),
    ],
)
def test_the_check_says_what_is_wrong(gatetune, tmp_path, body, says):
    (tmp_path / "mine.py").write_text(f"def run(request):\n    {body}\n")
    mission_file(tmp_path, function="mine:run")
    code, out, _ = gatetune("mission", "check", tmp_path / "mission.yaml")
    assert code == 1 and "not ready: " in out and says in out
