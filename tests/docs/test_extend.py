"""Every example of the pages about extending works: a part is one new file, a setting one line; another program is a fidelity."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from in_process import InProcessExecutor

from nbv import plugins
from nbv.config import preset
from tuner.missions.job import MissionJob

ROOT = Path(__file__).resolve().parent.parent.parent
BLOCK = re.compile(r'^```python title="([^"]*)"\n(.*?)^```$', re.DOTALL | re.MULTILINE)
PLAIN_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def examples():
    """(heading, [(title, code)]) of every section with code."""
    pages = ("docs/extend.md", "docs/how-to/your-mission.md", "CONTRIBUTING.md")
    sections = [
        s for page in pages for s in re.split(r"^## ", (ROOT / page).read_text(), flags=re.MULTILINE)[1:]
    ]
    found = [(section.splitlines()[0], BLOCK.findall(section)) for section in sections]
    return [(heading, blocks) for heading, blocks in found if blocks]


PARTS = [example for example in examples() if not example[0].startswith("A setting")]
SETTINGS = [example for example in examples() if example[0].startswith("A setting")]


@pytest.mark.slow
@pytest.mark.parametrize(("heading", "blocks"), PARTS, ids=[heading for heading, _ in PARTS])
def test_an_example_works_as_one_file(heading, blocks, tmp_path, monkeypatch):
    (new_file, code), (trial, check) = blocks
    assert trial == "try it" and "assert" in check
    (tmp_path / new_file).write_text(code)
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    plugins.use(str(tmp_path / new_file))
    exec(compile(check, f"extend.md, {heading}", "exec"), {})
    sys.modules.pop(Path(new_file).stem)


@pytest.mark.slow
@pytest.mark.parametrize(("heading", "blocks"), SETTINGS, ids=[heading for heading, _ in SETTINGS])
def test_a_setting_is_one_line(heading, blocks, tmp_path):
    (place, line), (_, check) = blocks
    file, owner = place.split(", ")
    assert line.strip().count("\n") == 0
    for package in ("nbv", "tuner"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "search_spaces").symlink_to(ROOT / "search_spaces")
    (tmp_path / "conditions").symlink_to(ROOT / "conditions")
    before, fields = re.split(rf"class {owner}\b.*:\n", (tmp_path / file).read_text())
    declaration = re.search(rf"class {owner}\b.*:\n", (tmp_path / file).read_text())[0]
    at = re.search(r"\n(?=\n    def |\n\n@|\n\nclass )", fields).start()
    (tmp_path / file).write_text(f"{before}{declaration}{fields[:at]}\n    {line}{fields[at:]}")
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    subprocess.run(
        [sys.executable, "-c", check], env={**os.environ, "PYTHONPATH": path}, cwd=tmp_path, check=True
    )


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md"])
def test_python_on_a_page_runs(page, capsys):
    for code in PLAIN_BLOCK.findall((ROOT / page).read_text()):
        exec(compile(code, page, "exec"), {})
    assert float(capsys.readouterr().out) > 50.0  # an F-score in percent


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


@pytest.mark.slow
def test_another_program_s_cloud_is_measured_and_its_failures_are_the_configuration_s(tmp_path, monkeypatch):
    (tmp_path / "scan.py").write_text(PROGRAM)
    monkeypatch.setenv("MISSION_PROGRAM", f"{sys.executable} {tmp_path / 'scan.py'}")
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    plugins.use(str(EXAMPLE))

    def fly(name, values, replicate=0):
        config = preset("campaign").with_values(values)
        job = MissionJob(name, config, "slab", replicate, tmp_path / name, fidelity="external-program")
        return InProcessExecutor().submit(job).result()

    heights_m = {"low": 3.0, "high": 8.0}
    low, high = (fly(name, {"pool.max_altitude_m": height_m}) for name, height_m in heights_m.items())
    assert low.record.status == high.record.status == "ok"
    assert (
        low.value("observable.completeness_48mm") < 90.0 < 99.0 < high.value("observable.completeness_48mm")
    )
    assert high.value("whole.accuracy_48mm") > 99.0 and high.value("costs.images") > 0
    broken = fly("broken", {}, replicate=1)
    assert broken.reason == "program_failed" and "status 1, no camera" in broken.record.message
    assert fly("other", {"gate.kind": "random"}).reason == "not_expressible"
    assert not broken.infrastructure_failure
    sys.modules.pop(EXAMPLE.stem)
