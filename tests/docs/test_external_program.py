"""The example of another program as a fidelity: what it is given, what is measured of its cloud, and how it fails."""

import sys
from pathlib import Path

import pytest
from in_process import InProcessExecutor

from nbv import plugins
from nbv.config import preset
from nbv.rocks import load_rock
from tuner.missions.job import MissionJob

EXAMPLE = Path(__file__).resolve().parents[2] / "docs/examples/external_program.py"
# A scanner that sees the rock up to the altitude that the authors' mission file allows.
PROGRAM = """
import json, sys, trimesh, yaml
from pathlib import Path
folder = Path(sys.argv[1])
mission = yaml.safe_load((folder / "unified_mission.yaml").read_text())["/**"]["ros__parameters"]
request = json.loads((folder / "request.json").read_text())
if request["replicate"]:
    sys.exit("no camera")
mesh = trimesh.load(folder / "mesh.ply", process=False)
points, _ = trimesh.sample.sample_surface(mesh, 200_000, seed=0)
seen = points[points[:, 2] <= -mission["min_altitude_ned"] / 4]
trimesh.PointCloud(seen).export(folder / "dense.ply")
(folder / "costs.json").write_text(json.dumps({"images": mission["image_budget"]}))
"""


@pytest.fixture
def fly(tmp_path, monkeypatch):
    (tmp_path / "scan.py").write_text(PROGRAM)
    monkeypatch.setenv("MISSION_PROGRAM", f"{sys.executable} {tmp_path / 'scan.py'}")
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    plugins.use(str(EXAMPLE))
    yield lambda values, replicate=0: _run(tmp_path / f"{replicate}-{values}", values, replicate)
    sys.modules.pop(EXAMPLE.stem)


def _run(directory, values, replicate):
    config = preset("campaign").with_values(values)
    job = MissionJob("a", config, "slab", replicate, directory, fidelity="external-program")
    return InProcessExecutor().submit(job).result()


@pytest.mark.slow
def test_its_cloud_is_measured_and_its_costs_are_the_missions(fly):
    low, high = (fly({"gate.kind": "hyb-h", "pool.max_altitude_m": height_m}) for height_m in (3.0, 8.0))
    assert low.record.status == high.record.status == "ok"
    complete = [t.value("observable.completeness_48mm") for t in (low, high)]
    assert complete[0] < 90.0 < 99.0 < complete[1]
    assert high.value("whole.accuracy_48mm") > 99.0 and high.value("costs.images") > 0
    assert high.value("costs.wall_s") > 0 and load_rock("slab").name == high.rock


@pytest.mark.slow
def test_its_failures_are_failures_of_the_configuration(fly):
    broken = fly({"gate.kind": "hyb-h"}, replicate=1)
    assert broken.reason == "program_failed" and "status 1, no camera" in broken.record.message
    assert fly({"gate.kind": "random"}).reason == "not_expressible"
    assert not broken.infrastructure_failure
