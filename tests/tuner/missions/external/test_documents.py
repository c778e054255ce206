"""Mission files, requests and results: what fits the schemas, and one line for what does not."""

import json
import os
import re
import sys
from pathlib import Path

import jsonschema
import pytest
import yaml

from nbv.errors import MissionFailure, UserError
from tuner.missions.external import MissionFile, Request, load_mission_file, read_result, take_slot
from tuner.missions.external.checking import KINDS, check, schema
from tuner.missions.external.program import program_files
from tuner.missions.external.skeleton_files import write_skeleton
from tuner.problem.quality_at_cost import asked_objective

FILE = {
    "schema": "gatetune.mission/1",
    "name": "mine",
    "command": ["python", "fly.py"],
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
    "resources": {"PX4": {"kind": "port", "first": 14540, "step": 10}, "WORK": {"kind": "folder"}},
}


def load(tmp_path, **changes) -> MissionFile:
    path = tmp_path / "mission.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in {**FILE, **changes}.items() if v is not None}))
    return load_mission_file(path)


def test_the_published_schemas_are_schemas():
    for kind in KINDS:
        jsonschema.Draft202012Validator.check_schema(schema(kind))


def test_a_mission_file_says_what_a_mission_takes(tmp_path):
    mission = load(tmp_path)
    assert mission.defaults() == {"gain": 1.0, "views": 12, "mode": "good"}
    assert mission.baselines == {"hand": {"gain": 2.0, "views": 12, "mode": "good"}}
    assert mission.instance("b").to_dict() == {"name": "b", "mesh": "b.obj", "wind_m_s": 3}
    assert mission.objective.measure({"f": {"score": 0.5}}) == 0.5


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"command": None}, "needs either command or function"),
        ({"command": "python fly.py"}, "command: .* is not of type 'array'"),
        (
            {"schema": "gatetune.mission/2"},
            "schema gatetune.mission/2; this version reads gatetune.mission/1",
        ),
        ({"direction": "up"}, "direction"),
        ({"parameters": {}}, "parameters"),
        ({"parameters": {"x": {"kind": "float", "low": 1, "high": 0, "default": 1}}}, "low must be less"),
        (
            {"parameters": {"x": {"kind": "float", "low": 0, "high": 1, "default": 2}}},
            "default 2 is not among",
        ),
        (
            {"parameters": {"x": {"kind": "float", "low": 0, "high": 1, "scale": "log", "default": 1}}},
            "above 0",
        ),
        ({"parameters": {"x": {"kind": "int", "default": 2}}}, "has low and high"),
        (
            {"parameters": {"x": {"kind": "float", "low": 0, "high": 1, "choices": [1, 2], "default": 1}}},
            "no choices",
        ),
        (
            {"parameters": {"x": {"kind": "categorical", "choices": [1, 2], "low": 0, "default": 1}}},
            "no low or high",
        ),
        ({"held_out": ["a"]}, "instance 'a' is named twice"),
        ({"baselines": {"hand": {"gian": 1}}}, "unknown parameter 'gian'"),
        ({"baselines": {"hand": {"gain": 99}}}, "gain = 99"),
        ({"resources": {"P": {"kind": "port", "first": 65534}}}, "would get port 65536"),
        (
            {"resources": {"P": {"kind": "port", "first": 5000}, "Q": {"kind": "port", "first": 5002}}},
            "port 5002 would belong to P of slot 2 and to Q of slot 0",
        ),
        ({"score": {}}, "instance 'a' has none"),
        ({"surprise": 1}, "surprise"),
        ({"time_limit_s": float("nan")}, "time_limit_s is nan; every number must be finite"),
        ({"time_limit_s": float("inf")}, "time_limit_s: inf is greater"),
        ({"stop_grace_s": float("nan")}, "stop_grace_s is nan"),
        ({"instances": [{"name": "a", "wind": float("inf")}]}, r"instances.0.wind is inf"),
        ({"instances": ["a\0"]}, r"instances.0 holds a zero byte"),
        (
            {
                "baselines": {},
                "parameters": {n: {"kind": "int", "low": 0, "high": 1, "default": 0} for n in ("a.b", "a_b")},
            },
            "'a.b' and 'a_b' would both be PARAMETER_a_b",
        ),
        ({"resources": {"../..": {"kind": "folder"}}}, "'../..' names a folder"),
        ({"resources": {"LD_PRELOAD": {"kind": "folder"}}}, "'LD_PRELOAD' names .* nothing that means"),
        ({"resources": {"PATH": {"kind": "folder"}}}, "'PATH' names .* nothing that means"),
        (
            {"resources": {"GATETUNE_RESULT": {"kind": "number"}}},
            "'GATETUNE_RESULT' names .* nothing that means",
        ),
    ],
)
def test_a_mistake_in_a_mission_file_is_one_line(tmp_path, changes, says):
    with pytest.raises(UserError, match=says) as error:
        load(tmp_path, **changes)
    assert "\n" not in str(error.value) and "mission.yaml" in str(error.value)


def test_a_request_fits_its_schema_and_names_what_the_slot_owns(tmp_path):
    mission = load(tmp_path)
    with (
        take_slot(mission, tmp_path / "slots", 1.0) as first,
        take_slot(mission, tmp_path / "slots", 1.0) as slot,
    ):
        request = Request(mission, "0007", mission.defaults(), "b", 2, tmp_path / "out", slot)
        tree = json.loads(request.write().read_text())
    jsonschema.validate(tree, schema("request"))
    assert first.resources["PX4"] == 14540 and tree["resources"]["PX4"] == 14550
    assert tree["instance"]["wind_m_s"] == 3 and tree["replicate"] == 2


def test_the_seed_is_the_instances_and_the_replicates(tmp_path):
    mission = load(tmp_path)
    with take_slot(mission, tmp_path / "slots", 1.0) as slot:

        def seed(values, instance, replicate):
            return Request(mission, "1", values, instance, replicate, tmp_path, slot).to_dict()["seed"]

        assert seed({"gain": 1}, "a", 0) == seed({"gain": 2}, "a", 0)
        assert len({seed({}, "a", 0), seed({}, "a", 1), seed({}, "b", 0)}) == 3


def test_a_slot_is_free_again_when_its_owner_ends(tmp_path):
    mission = load(tmp_path, at_once=1)
    with (
        take_slot(mission, tmp_path, 1.0),
        pytest.raises(MissionFailure, match="at_once"),
        take_slot(mission, tmp_path, 0.1),
    ):
        pass
    with take_slot(mission, tmp_path, 0.1) as slot:
        assert slot.number == 0


OK = {"schema": "gatetune.result/1", "status": "ok", "metrics": {"f": {"score": 0.5}}}


def left(tmp_path, content):
    path = tmp_path / "result.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_a_result_is_read(tmp_path):
    result = read_result(left(tmp_path, {**OK, "cost": {"flight_s": 12}, "artefacts": {"cloud": "c.ply"}}))
    assert (
        result.metrics == {"f": {"score": 0.5}}
        and result.cost == {"flight_s": 12.0}
        and result.failure is None
    )


def test_a_failure_says_whose_it_is(tmp_path):
    tree = {
        "schema": "gatetune.result/1",
        "status": "failed",
        "failure": {"of": "configuration", "reason": "crash"},
    }
    failure = read_result(left(tmp_path, tree)).failure
    assert failure is not None and (failure.of, failure.reason) == ("configuration", "crash")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "is empty"),
        ('{"schema": "gatetune.result/1", "sta', "is not valid JSON"),
        ('{"schema": "gatetune.result/1", "status": "ok", "metrics": {"f": NaN}}', "holds NaN"),
        (
            '{"schema": "gatetune.result/1", "status": "ok", "metrics": {"f": 1e999}}',
            "metrics.f is not a finite",
        ),
        ("[" * 100_000, "is not valid JSON"),
        ("[]", "is not of type 'object'"),
        ({**OK, "schema": "gatetune.result/2"}, "schema gatetune.result/2; this version reads"),
        ({**OK, "metrics": {"f": "good"}}, "metrics"),
        ({"schema": "gatetune.result/1", "status": "ok"}, "needs metrics or cloud"),
        ({"schema": "gatetune.result/1", "status": "failed"}, "failure"),
        ({**OK, "artefacts": {"x": "../../etc/passwd"}}, "no file in the mission's own folder"),
        ({**OK, "artefacts": {"x": ""}}, "x is '', no file in the mission's own folder"),
        ({**OK, "artefacts": {"x": "a\0"}}, "no file in the mission's own folder"),
    ],
)
def test_a_mistake_in_a_result_is_one_line(tmp_path, content, says):
    with pytest.raises(UserError, match=says) as error:
        read_result(left(tmp_path, content))
    assert "\n" not in str(error.value)


def test_no_result_is_one_line(tmp_path):
    with pytest.raises(UserError, match=r"no result\.json"):
        read_result(tmp_path / "result.json")


def test_a_result_that_is_a_link_is_not_followed(tmp_path):
    (tmp_path / "elsewhere.json").write_text(json.dumps(OK))
    (tmp_path / "result.json").symlink_to("elsewhere.json")
    with pytest.raises(UserError, match=r"result\.json is a link"):
        read_result(tmp_path / "result.json")


def test_the_documents_of_the_how_to_page_fit():
    page = (Path(__file__).resolve().parents[4] / "docs/how-to/your-mission.md").read_text()
    documents = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", page, re.DOTALL)]
    kinds = [tree["schema"].removeprefix("gatetune.").partition("/")[0] for tree in documents]
    assert kinds == ["request", "result", "result"]
    for kind, tree in zip(kinds, documents, strict=True):
        check(tree, kind, "the page")


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("f.score@costs.views<=20", (("f.score", "maximise"), ("costs.views", "minimise"), 20.0)),
        ("costs.views@f.score>=0.9", (("costs.views", "minimise"), ("f.score", "maximise"), 0.9)),
        ("sharpness@costs.battery>=0.2", (("sharpness", "maximise"), ("costs.battery", "maximise"), 0.2)),
    ],
)
def test_objectives_of_a_mission_file_are_its_own_metrics_and_costs(tmp_path, text, means):
    mission = load(tmp_path, directions={"sharpness": "maximise", "costs.battery": "maximise"})
    asked = asked_objective(text, mission.directions)
    found = [(o.metric, o.direction) for o in (asked.objective, asked.second)]
    assert (*found, asked.limit) == means
    with pytest.raises(
        UserError, match=r"say it in the mission file, such as directions: \{blur: maximise\}"
    ):
        asked_objective("blur@costs.views<=20", mission.directions)


def test_a_skeleton_is_called_as_asked(tmp_path):
    write_skeleton(tmp_path / "survey")
    write_skeleton(tmp_path / "other", "mine")
    assert load_mission_file(tmp_path / "survey/mission.yaml").name == "survey"
    assert load_mission_file(tmp_path / "other/mission.yaml").name == "mine"
    with pytest.raises(UserError, match="'a b' cannot name a mission"):
        write_skeleton(tmp_path / "a b")


SOURCES = {
    "fly.py": "import near\nfrom lib.deep import more\nfrom pack import inner\n",
    "near.py": "",
    "lib/deep/more.py": "",
    "pack/__init__.py": "",
    "pack/inner.py": "",
    "scripts/run.sh": ". scripts/common.sh\npython scripts/plan.py",
    "scripts/common.sh": "",
    "scripts/plan.py": "import beside",
    "scripts/beside.py": "",
    "elsewhere/tool.sh": "",
    "unrelated.py": "",
    "planner": "binary",
}
BY_COMMAND = {"scripts/run.sh", "scripts/common.sh", "scripts/plan.py", "scripts/beside.py"}


@pytest.mark.parametrize(
    ("command", "function", "files"),
    [
        ([], "fly:fly", {"fly.py", "near.py", "lib/deep/more.py", "pack/__init__.py", "pack/inner.py"}),
        (["sh", "scripts/run.sh"], "", BY_COMMAND),
        ([sys.executable, "-m", "scripts.plan"], "", {"scripts/plan.py", "scripts/beside.py"}),
        (["./planner", "/bin/sh", "../elsewhere/tool.sh"], "", {"planner", "../elsewhere/tool.sh"}),
        (["./linked.sh"], "", {"linked.sh"}),
    ],
)
def test_the_files_of_a_program(tmp_path, command, function, files):
    """Those of the how-to page: what is named, and the Python and shell files that this names."""
    folder = tmp_path / "mission"
    for name, text in SOURCES.items():
        path = (tmp_path if name.startswith("elsewhere") else folder) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (folder / "linked.sh").symlink_to("../elsewhere/tool.sh")
    found = {os.path.relpath(path, folder) for path in program_files(folder, command, function)}
    assert files <= found and "unrelated.py" not in found
