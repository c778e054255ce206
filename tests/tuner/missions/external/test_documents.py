import json
import re
from pathlib import Path

import pytest
import yaml

from nbv.errors import UserError
from tuner.missions.executors import limit_s
from tuner.missions.external.mission_file import MissionFile, load_mission_file
from tuner.missions.external.program import read_result, seed_of

FILE = {
    "name": "mine",
    "command": ["python", "run.py"],
    "parameters": {
        "gain": {"kind": "float", "low": 0.1, "high": 10, "scale": "log", "default": 1.0},
        "views": {"kind": "int", "low": 4, "high": 40, "default": 12},
        "mode": {"kind": "categorical", "choices": ["fast", "good"], "default": "good"},
    },
    "instances": ["a", {"name": "b", "mesh": "b.obj", "wind_m_s": 3}],
    "held_out": ["c"],
    "metric": "f.score",
    "direction": "maximise",
    "baselines": {"hand": {"gain": 2.0}},
    "at_once": 3,
}


def load(tmp_path, **changes) -> MissionFile:
    path = tmp_path / "mission.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in {**FILE, **changes}.items() if v is not None}))
    return load_mission_file(path)


def test_a_mission_file_says_what_a_mission_takes(tmp_path):
    mission = load(tmp_path)
    assert mission.complete({}) == {"gain": 1.0, "views": 12, "mode": "good"}
    assert mission.complete(mission.baselines["hand"])["gain"] == 2.0
    assert mission.instance("b") == {"name": "b", "mesh": "b.obj", "wind_m_s": 3}
    assert mission.objective.measure({"f": {"score": 0.5}}) == 0.5
    # Its own limit counts, wherever it runs.
    assert limit_s(10.0, load(tmp_path, time_limit_s=7200)) > 7200 and limit_s(10.0, None) == 10.0


def choices(values, default=None):
    mode = {"kind": "categorical", "choices": values, "default": values[0] if default is None else default}
    return {"parameters": {"mode": mode}, "baselines": {}}


def test_a_choice_is_stored_as_it_was_declared(tmp_path):
    mission = load(tmp_path, **choices([1, 2], 1.0))
    assert {repr(mission.complete(v)["mode"]) for v in ({}, {"mode": 1}, {"mode": True})} == {"1"}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"name": None}, "'name' is missing"),
        ({"name": "a b"}, "name is 'a b'; it must be at most 64 letters, digits"),
        ({"command": None}, "give either command or function"),
        ({"command": "python run.py"}, "command is 'python run.py'; it must be a list"),
        ({"direction": "up"}, "direction is 'up'; it must be one of maximise, minimise"),
        ({"parameters": {}}, "parameters"),
        ({"parameters": {"a.b": {"low": 0, "high": 1, "default": 1}}}, "the name 'a.b' must be a letter"),
        ({"directions": {"f": "up"}}, "directions"),
        ({"function": "shots.fly", "command": None}, "function is 'shots.fly'; it must be MODULE:FUNCTION"),
        ({"replicates": 0}, "replicates is 0; it must be a whole number at least 1"),
        ({"command": ["a", 1]}, r"command\[1\] is 1; it must be text"),
        ({"score": {"frame": "none"}}, "score.frame is 'none'; it must be"),
        ({"parameters": {"x": {"low": 1, "high": 0, "default": 1}}}, "not below high"),
        ({"parameters": {"x": {"low": 0, "high": 1, "default": 2}}}, "x needs a default among its values"),
        ({"parameters": {"x": {"low": 0, "high": 1}}}, "x needs a default among its values"),
        (choices([1, 1.0, 2]), "1 and 1.0 are one value"),
        (choices([True, 1]), "True and 1 are one value"),
        (choices(["a", "b", "a"]), "'a' is given twice"),
        (choices(["1", 1]), "'1' and 1 are one value"),
        ({"metric": "loss@costs.kg<=2"}, "metric: loss.*--objective 'loss@costs.kg<=2'"),
        ({"instances": ["a", 7]}, "instance 7 has no name"),
        ({"instances": ["a", "a"]}, "instance 'a' is named twice"),
        ({"held_out": ["a"]}, "'a' is an instance and held out"),
        ({"baselines": {"hand": {"gian": 1}}}, "unknown parameter 'gian'"),
        ({"baselines": {"hand": {"gain": 99}}}, "gain = 99"),
        ({"score": {}}, "instance 'a' has none"),
        ({"surprise": 1}, "unknown key 'surprise'; allowed: name, parameters"),
        ({"time_limit_s": float("nan")}, "time_limit_s"),
        ({"at_once": 0}, "at_once"),
    ],
)
def test_a_mistake_in_a_mission_file_is_one_line(tmp_path, changes, says):
    with pytest.raises(UserError, match=says) as error:
        load(tmp_path, **changes)
    assert "\n" not in str(error.value) and "mission.yaml" in str(error.value)
    assert not re.search(r"`|\$|regex|Expected", str(error.value)), error.value


OK = {"metrics": {"f": {"score": 0.5}}}


def left(tmp_path, content):
    path = tmp_path / "result.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "not valid JSON"),
        ('{"metrics": {"f": 1', "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ({**OK, "cost": {"fuel": 1}}, "unknown key 'cost'"),
        ({"metrics": "good"}, "metrics"),
        ({"metrics": {}}, "needs metrics, cloud or failure"),
        ({"failure": ""}, "failure"),
        ({"cloud": {"path": "x.ply", "cameras": {"1": {"estimated": [1, 2], "reported": [1, 2, 3]}}}}, "length 3"),
    ],
)  # fmt: off
def test_a_mistake_in_a_result_is_one_line(tmp_path, content, says):
    with pytest.raises(UserError, match=says) as error:
        read_result(left(tmp_path, content))
    assert "\n" not in str(error.value)


def test_the_results_of_the_how_to_page_are_results(tmp_path):
    page = (Path(__file__).resolve().parents[4] / "docs/how-to/your-mission.md").read_text()
    request, *results = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    assert json.loads(request)["seed"] == seed_of(json.loads(request)["instance"]["name"], 0)
    found = [read_result(left(tmp_path, text)) for text in results]
    assert found[0].metrics and found[0].costs and found[1].failure
