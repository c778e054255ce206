"""Parts of other packages: found by name, recorded, refused in one line where they are none; the command."""

import json
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refused
from scene_helpers import SMALL_GROUND
from typer.testing import CliRunner

from nbv import plugins
from nbv.cache import Store
from nbv.config import RENDERERS, SCORERS, Weights, config_from_dict, parameter, preset
from nbv.config.declaration import Section
from nbv.errors import UserError
from nbv.gates import Gate, make_gate
from nbv.geometric import run_geometric_mission
from nbv.geometry.frames import look_at
from nbv.mission import MissionResult
from nbv.photogrammetric.simulated_camera import SimulatedCamera
from nbv.rocks import load_coarse_rock
from nbv.scene import build_scene, make_renderer
from nbv.scorers import Scorer
from nbv.types import GateDecision, Ranking, Viewpoint
from tuner.cli import app
from tuner.missions.job import MissionJob
from tuner.missions.pool import run_job

MINE = """
from dataclasses import dataclass
import numpy as np
from nbv.config import Weights
from nbv.config.declaration import Section, Share, not_in_paper
from nbv.rocks import sdf
from nbv.scene.raycast import RaycastRenderer
from nbv.scorers import Scorer

@dataclass(frozen=True)
class Settings(Section):
    alpha: Share = not_in_paper(0.5, "how low")

def low(terms, pool, config):
    return 1.0 - config.mine_low.alpha * pool.positions_m[:, 2] / 4.0 + 0.0 * terms.rng.random()

LOW = Scorer("mine-low", low, weights=lambda config: Weights(), settings=Settings)
NOTHING = 3

class Dim(RaycastRenderer):
    def rgb(self, camera_from_world):
        return super().rgb(camera_from_world) // 2

def egg(p, rng, seed):
    return sdf.ellipsoid(p, (0.0, 0.0, 0.75), (rng.uniform(0.5, 0.6), 0.5, 0.8), np.eye(3))
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A module ``mine_package`` and what entry points say of it: call it with ``name=place`` and so on."""
    (tmp_path / "mine_package.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    monkeypatch.setattr(plugins, "_left_out", {})
    said = {}

    def entry_points(group):
        return said.get(group, [])

    def bring(group, *parts, distribution="mine-dist"):
        dist = SimpleNamespace(name=distribution, version="1.2")
        said.setdefault(f"gatetune.{group}", []).extend(
            SimpleNamespace(name=name, value=place, dist=dist) for name, place in parts
        )
        plugins.installed.cache_clear()

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    plugins.installed.cache_clear()
    yield bring
    plugins.installed.cache_clear()
    sys.modules.pop("mine_package", None)


def short(**values):
    return preset("campaign").with_values({"photographs": 26, **values})


def test_an_installed_scorer_flies_with_its_own_settings(package, tmp_path):
    package("scorers", ("mine-low", "mine_package:LOW"))
    assert "mine-low" in list(SCORERS) and "mine_package" not in sys.modules, (
        "nothing is imported before it is named"
    )
    config = short(**{"gate.kind": "mine-low", "mine_low.alpha": 0.7})
    assert config.mine_low.alpha == 0.7 and config_from_dict(config.to_dict()) == config
    assert parameter("mine_low.alpha").meaning == "how low"
    mission = run_geometric_mission(config, "slab-3")
    assert {capture.scorer for capture in mission.trace} == {"mine-low"}
    facts = mission.provenance["plugins"]["scorers/mine-low"]
    assert (facts["distribution"], facts["version"]) == ("mine-dist", "1.2")
    assert short().digest() != config.digest() != config.with_values({"mine_low.alpha": 0.6}).digest()
    default = config.with_values({"mine_low.alpha": 0.5})
    assert default.plugins == ()
    before = default.digest()
    (tmp_path / "mine_package.py").write_text(MINE + "# changed\n")
    plugins.installed.cache_clear()
    assert default.digest() != before, "what is kept of missions notices another source"


@pytest.mark.parametrize(
    ("parts", "values", "said"),
    [
        ([("a", "no_such_module:A")], {"gate.kind": "a"}, "scorer 'a' of mine-dist 1.2 cannot be imported"),
        ([("a", "mine_package:GONE")], {"gate.kind": "a"}, "has no attribute 'GONE'"),
        ([("a", "mine_package:NOTHING")], {"gate.kind": "a"}, "is no scorer: an object without main_term"),
        ([("a", "mine_package:LOW"), ("a", "other:LOW")], {"gate.kind": "a"}, "two scorers are called 'a'"),
        ([], {"gate.kind": "mine"}, "or a plug-in that is installed or named with gatetune --plugin"),
        ([], {"mine.alpha": 1}, "unknown mission parameter 'mine.alpha'"),
        ([("mine-low", "mine_package:LOW")], {"mine_low.alpha": 2}, "mine_low.alpha is 2; it must be"),
        ([("mine-low", "mine_package:LOW")], {"mine_low.beta": 2}, "parameter 'mine_low.beta'"),
    ],
)
def test_a_bad_plug_in_is_one_line_before_anything_runs(package, parts, values, said):
    package("scorers", *parts)
    refused(re.escape(said), short, **values)


def test_a_scorer_without_finite_scores_fails_its_mission(package):
    def nowhere(terms, pool, config):
        return np.full(len(pool), np.nan)

    plugins.register("scorers", "bad", Scorer("bad", nowhere, weights=lambda config: Weights()))
    mission = flown("bad")
    assert (mission.status, mission.reason) == ("failed", "scores_not_finite")


@pytest.mark.parametrize("error", [ZeroDivisionError("by zero"), SystemExit(3)])
def test_a_planner_that_raises_is_a_failed_mission_that_names_the_line(package, tmp_path, error):
    def raising(gate, state, pool, rankings):
        raise error

    register_gate("bad", raising)
    job = MissionJob("a", short(**{"gate.kind": "bad"}), "slab-3", 0, tmp_path / "a", fidelity="geometric")
    assert run_job(job.to_dict()) != 0
    failed = MissionResult.load(tmp_path / "a")
    assert failed.reason == "mission_error"
    assert f"{type(error).__name__}: {error} ({Path(__file__).name}, line" in failed.message


def flown(kind, **more):
    return run_geometric_mission(short(**{"gate.kind": kind}), "slab-3", **more)


def register_gate(name, decide):
    plugins.register("gates", name, type(name, (Gate,), {"decide": decide}))


def test_what_is_registered_reaches_workers_unless_it_is_in_the_script_itself(package, tmp_path):
    (tmp_path / "mine_registers.py").write_text(
        MINE + "from nbv.plugins import register\nregister('scorers', 'mine-low', LOW)\n"
    )
    plugins.use(str(tmp_path / "mine_registers.py"))
    assert plugins.plugin_specs() == [str(tmp_path / "mine_registers.py")]
    with pytest.raises(UserError, match="two scorers are called 'mine-low'"):
        plugins.register("scorers", "mine-low", sys.modules["mine_registers"].LOW)
    code = "from nbv.plugins import register; register('scorers', 'shell', LOW)"
    exec(code, {"__name__": "__main__", "LOW": sys.modules["mine_registers"].LOW})
    refused("registered in a script or notebook itself", plugins.plugin_specs)
    refused("cannot be imported", plugins.use, "no_such_module")
    refused(r"--plugin no_such\.py: there is no such file", plugins.use, "no_such.py")
    (tmp_path / "faceless.py").write_text(
        "from nbv.plugins import register\nregister('scorers', 'a', object())\n"
    )
    with pytest.raises(UserError, match=r"^scorer 'a' of faceless is no scorer: an object without main_term"):
        plugins.use(str(tmp_path / "faceless.py"))
    (tmp_path / "registers_nothing.py").write_text("")
    refused("registers_nothing registers nothing", plugins.use, str(tmp_path / "registers_nothing.py"))
    (tmp_path / "json.py").write_text("")
    refused(r"another module is called json .* rename the file", plugins.use, str(tmp_path / "json.py"))
    refused("there is no group 'planners'", plugins.register, "planners", "a", None)
    with pytest.raises(UserError, match="settings must be a frozen dataclass"):
        bad = SimpleNamespace(main_term=0, weights=0, rank=0, settings=Section())
        plugins.register("scorers", "b", bad)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frontier-density", "fisher-information"])
def test_the_planners_of_the_examples_plan(package, monkeypatch, name):
    folder = name.replace("-", "_")
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs/examples" / folder)
    package("scorers", (name, f"gatetune_{folder}:PLANNER"))
    mission = flown(name)
    assert {capture.scorer for capture in mission.trace} == {name}, mission.message
    assert all(0.0 < capture.top[name]["main"] <= 1.0 for capture in mission.trace)


def last(gate, state, pool, rankings):
    scores = np.arange(len(pool), dtype=float)
    return GateDecision(Ranking("last", np.arange(len(pool))[::-1], scores, {"main": scores}), "last")


def test_a_planner_is_not_told_which_rock_it_is(package):
    register_gate("reaching", last)
    gates = [make_gate(short(**{"gate.kind": "reaching"}), sha256) for sha256 in ("a" * 64, "b" * 64)]
    assert [gate.rock_sha256 for gate in gates] == ["", ""]
    seen = [
        SimpleNamespace(iteration=0, model=SimpleNamespace(points_m=np.full((2, 3), x))) for x in (0.0, 1.0)
    ]
    first, same, other = (
        gate.rng(state).random() for gate, state in zip([*gates, gates[0]], [*seen[:1] * 2, seen[1]])
    )
    assert first == same != other, "a planner draws by what it sees"
    assert make_gate(short(), "a" * 64).rock_sha256 == "a" * 64, "what is built in draws as before"


def test_an_installed_part_with_a_built_in_name_is_left_out_and_named(package):
    for group, name in (("scorers", "covis"), ("gates", "random"), ("renderers", "raycast")):
        package(group, (name, "mine_package:LOW"))
    package("families", ("boulder", "mine_package:LOW"))
    assert short(**{"gate.kind": "covis"}).plugins_used == []
    assert load_coarse_rock("boulder-3", Store()).name == "boulder-3"
    assert RENDERERS.sources("raycast") == []
    said = {line.partition(" of ")[0]: line for line in plugins.left_out()}
    assert {"scorer 'covis'", "gate 'random'", "renderer 'raycast'", "family 'boulder'"} <= said.keys()
    assert said["scorer 'covis'"].endswith("is left out; rename it or uninstall mine-dist")
    plugins.register("families", "slab", lambda p, rng, seed: p)
    with pytest.raises(UserError, match=r"family 'slab' .* has the name of one that is built in; rename it"):
        load_coarse_rock("slab-3", Store())


def gatetune(*arguments):
    result = CliRunner().invoke(app, list(map(str, arguments)))
    if isinstance(result.exception, UserError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scorer", "gate"])
def test_a_written_package_installs_and_its_test_passes(kind, tmp_path):
    folder = tmp_path / "mine"
    gatetune("plugin", "init", "my-own", "--out", folder, *(["--gate"] if kind == "gate" else []))
    assert "my_own.alpha" in (folder / "README.md").read_text()
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, tmp_path / "site", folder], check=True, cwd=tmp_path)
    path = os.pathsep.join([str(tmp_path / "site"), *(p for p in sys.path if p)])
    environment = {**os.environ, "PYTHONPATH": path}
    test = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", folder / "tests"]
    subprocess.run(test, check=True, cwd=folder, env=environment)
    listed = [sys.executable, "-m", "tuner.cli", "plugin", "list", "--json"]
    said = json.loads(subprocess.run(listed, check=True, env=environment, capture_output=True).stdout)
    row = {"name": "my-own", "group": f"{kind}s", "distribution": "gatetune-my-own", "version": "0.1.0"}
    assert row in said


def test_init_and_list_refuse_and_say_when_there_is_nothing(tmp_path, monkeypatch):
    refused("cannot name a plug-in", gatetune, "plugin", "init", "Mine!")
    for taken in ("random", "pool"):
        with pytest.raises(UserError, match=f"'{taken}' is already the name of a strategy or section"):
            gatetune("plugin", "init", taken, "--out", tmp_path / taken)
    refused("exists", gatetune, "plugin", "init", "mine", "--out", tmp_path)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [])
    monkeypatch.setattr(plugins, "_registered", {})
    plugins.installed.cache_clear()
    assert "no plug-in is installed" in gatetune("plugin", "list")
    plugins.installed.cache_clear()


def test_photographs_and_rocks_are_made_again_where_the_source_changes(package, tmp_path):
    package("renderers", ("dim", "mine_package:Dim"))
    package("families", ("egg", "mine_package:egg"))
    config = preset("campaign").with_values({"scene.backend": "dim"})
    store, made = Store(tmp_path / "store"), []
    pose = look_at((3.5, 0.0, 1.5), config.target_m)

    def photograph():
        rock = load_coarse_rock("egg-3", store)

        def renderer(camera):
            made.append(rock.sha256)
            return make_renderer(build_scene(rock, config.scene, camera, SMALL_GROUND), "dim")

        camera = SimulatedCamera(renderer, rock, 0, config, store)
        return camera.photograph(Viewpoint("a", (3.5, 0.0, 1.5), 0.0, 20.0, "low"), pose)

    first = photograph()
    assert np.array_equal(photograph(), first) and len(made) == 1
    (tmp_path / "mine_package.py").write_text(MINE.replace("// 2", "// 4"))
    plugins.installed.cache_clear()
    sys.modules.pop("mine_package")
    assert photograph().mean() < 0.6 * first.mean() and len(made) == 2
