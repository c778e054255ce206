"""The authors' mission through the contract, on a stand-in for their stack: what it is told, what is read, whose failure it is."""

import re

import numpy as np
import photogrammetry_nbv_stand_in as stand_in
import pytest
import trimesh

from nbv.geometry.frames import align_umeyama
from tuner.bridges.photogrammetry_nbv import flying, read_file, write_mission_folder
from tuner.bridges.photogrammetry_nbv.flying import configuration, write_files
from tuner.bridges.photogrammetry_nbv.result import MissionUnfinishedError, _onto_our_mesh
from tuner.missions.external import Request, external_config, load_mission_file, take_slot
from tuner.missions.external.ending import marked


def mission_file(folder, fault="", fixed=None, agent=None):
    """The shipped mission file with the stand-in in place of the stack."""
    write_mission_folder(folder / "mission")
    stand_in.take_the_place(folder / "mission" / "mission.yaml", fault, fixed or {}, agent)
    return load_mission_file(folder / "mission" / "mission.yaml")


@pytest.fixture
def fly(tmp_path, monkeypatch):
    """Fly in this process; `tests/tuner/commands/test_authors_page.py` flies through the contract."""

    def fly(fault="", values=None, their_scoring="", **changes):
        mission = mission_file(tmp_path, fault, **changes)
        if their_scoring:
            (mission.folder / "scoring.yaml").write_text(their_scoring)
        monkeypatch.chdir(mission.folder)
        monkeypatch.setenv("GATETUNE_MISSION", str(tmp_path))
        with take_slot(mission, tmp_path / "slots", 1.0) as slot:
            for name, value in slot.environment().items():
                monkeypatch.setenv(name, value)
            config = external_config(mission, values)
            request = Request(mission, "1", config.values, "sample_15016", 0, tmp_path / "o", slot)
            request.write()
            try:
                return flying.fly(request.to_dict())
            finally:
                assert not marked(str(tmp_path))

    return fly


def test_a_mission_is_flown_and_its_cloud_aligned(fly, tmp_path):
    result = fly(values={"covis.weights.nov": 0.2, "covis.weights.move": 0.05})
    assert result["cost"] == {"seed_photographs": 24, "adaptive_photographs": 3, "registered": 27}
    cameras = result["cloud"]["cameras"].values()
    world = align_umeyama(
        np.array([c["reported"] for c in cameras]), np.array([c["estimated"] for c in cameras])
    )
    points = world.apply(trimesh.load(tmp_path / "o" / result["cloud"]["path"]).vertices)
    np.testing.assert_allclose(np.linalg.norm(points - (0, 0, 0.8), axis=1), 0.8, atol=1e-4)
    written = read_file(tmp_path / "o/scoring.yaml", "scoring.yaml")
    assert (written["weights.novelty"], written["weights.movement_cost"]) == (0.2, 0.05)
    assert not [*(tmp_path / "scripts").iterdir()]  # each mission has a copy of the folder


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("dies", "node ended with status 1 in the middle"),
        ("lands", "1 of 3 adaptive photographs"),
        ("dense", "dense reconstruction failed"),
        ("silent", "nothing moves: .* run px4-sitl-doctor"),
        ("half", "phase2_manifest.json is not valid JSON"),
        ("floods", "node floods its log"),
    ],
)
def test_what_the_machine_did_says_nothing_of_a_mission(fly, monkeypatch, fault, says):
    monkeypatch.setattr(flying, "_LARGEST_LOG_BYTES", 100_000)
    failure = fly(fault)["failure"]
    assert failure["of"] == "machine" and re.search(says, failure["message"])
    assert "\n" not in failure["message"]


def test_a_program_that_is_not_there_is_one_line(fly):
    failure = fly(agent="MicroXRCEAgent-not-here udp4")["failure"]
    assert failure["of"] == "machine" and failure["message"].startswith("cannot start agent")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("scorer: {weights: {novlty: 1}}", "did you mean weights.novelty"),
        ("scorer: [", "mend the YAML"),
        ("score: {}", "has no mapping scorer"),
    ],
)
def test_a_mistake_in_their_files_is_no_configurations(fly, tmp_path, text, says):
    failure = fly(their_scoring=text)["failure"]
    assert failure["of"] == "machine" and says in failure["message"] and "\n" not in failure["message"]


def test_no_candidate_is_the_configurations_fault(fly):
    failure = fly(fixed={"pool.max_travel_m": 0.01})["failure"]
    assert (failure["of"], failure["reason"]) == ("configuration", "no_candidates")


@pytest.mark.parametrize(("most", "says"), [(28, "dense"), (29, "4 of 5 adaptive photographs")])
def test_what_max_photographs_leaves_is_a_whole_mission(tmp_path, most, says):
    images = tmp_path / "adaptive/images"
    images.mkdir(parents=True)
    for number in range(4):
        (images / f"{number}.png").touch()
    log = tmp_path / "log"
    log.touch()
    config = configuration({}, {"stop.max_photographs": most}, tmp_path)  # 24 are seeds
    with pytest.raises(MissionUnfinishedError, match=says):
        flying._require_full(tmp_path, log, config)


def test_the_second_vehicle_has_topics_of_its_own(tmp_path):
    stack = {"start": {}}
    config = configuration({"covis.weights.nov": 0.3}, {}, tmp_path)
    files = write_files(config, stack, {"PX4_INSTANCE": 2}, tmp_path / "o", tmp_path)
    written = read_file(files["mission"], "unified_mission.yaml")
    assert written["local_position_topic"] == "/px4_2/fmu/out/vehicle_local_position_v1"
    assert written["image_topic"] == "/rgbd/image"  # of the world, which has a ROS domain of its own
    assert config.b_aware.weights.nov == 0.3  # shared there


def test_their_own_files_are_the_base(tmp_path):
    (tmp_path / "scoring.yaml").write_text("scorer: {min_track_length: 3, weights: {novelty: 0.7}}")
    (tmp_path / "unified_mission.yaml").write_text("/**: {ros__parameters: {settle_time_sec: 1.0}}")
    config = configuration({}, {"pool.min_altitude_m": 1.3}, tmp_path)
    assert (config.shared.min_track_length, config.covis.weights.nov, config.flight.settle_s) == (3, 0.7, 1.0)


def test_cameras_stand_about_the_mesh_as_in_their_world(tmp_path):
    """A vertex of their object, 20 times as large at the rock's centre, is where an imported mesh has it."""
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    mesh.apply_translation((0.01, -0.02, 0.005))
    mesh.export(tmp_path / "box.obj")
    target = (0.0, 0.0, 0.8)
    theirs = {str(i): 20 * v + target for i, v in enumerate(mesh.vertices)}
    ours = _onto_our_mesh(theirs, tmp_path / "box.obj", 20.0, target)
    placed = np.array(list(ours.values()))
    np.testing.assert_allclose(placed.min(0), (-0.32, -0.4, 0.0), atol=1e-6)
    np.testing.assert_allclose(placed.max(0), (0.32, 0.4, 1.6), atol=1e-6)
