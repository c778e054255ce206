"""Parts of other packages: found by name, guarded, recorded, and refused in one line where they are none."""

import ctypes
import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nbv import plugins
from nbv.cache import Store
from nbv.config import RENDERERS, SCORERS, Weights, config_from_dict, parameter, preset
from nbv.config.declaration import Section
from nbv.errors import MissionFailure, UserError
from nbv.gates import Gate, external, make_gate
from nbv.geometric import run_geometric_mission
from nbv.mission import MissionResult
from nbv.rocks import load_coarse_rock
from nbv.scorers import Scorer
from nbv.types import GateDecision, Ranking
from tuner.missions.job import MissionJob
from tuner.missions.run_job import run_job

MINE = """
from dataclasses import dataclass
from nbv.config import Weights
from nbv.config.declaration import Section, Share, not_in_paper
from nbv.scorers import Scorer

@dataclass(frozen=True)
class Settings(Section):
    alpha: Share = not_in_paper(0.5, "how low")

def low(terms, pool, config):
    return 1.0 - config.mine_low.alpha * pool.positions_m[:, 2] / 4.0 + 0.0 * terms.rng.random()

LOW = Scorer("mine-low", low, weights=lambda config: Weights(), settings=Settings)
NOTHING = 3
"""
PROGRAM = """
import json, sys, time
for line in sys.stdin:
    state = json.loads(line)
    heights = [z for _, _, z in state["pool"]["positions_m"]]
    print(json.dumps({ANSWER}), flush=True)
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A module ``mine_package`` and what entry points say of it: call it with ``name=place`` and so on."""
    (tmp_path / "mine_package.py").write_text(MINE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(plugins.registry, "_registered", {})
    monkeypatch.setattr(plugins.registry, "_used", {})
    monkeypatch.setattr(plugins.registry, "_left_out", {})
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
    return preset("campaign").with_values({"stop.adaptive_budget": 2, **values})


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
        ([("mine-low", "mine_package:LOW")], {"mine_low.alpha": 2}, "mine_low.alpha is 2.0; it must be"),
        ([("mine-low", "mine_package:LOW")], {"mine_low.beta": 2}, "parameter 'mine_low.beta'"),
    ],
)
def test_a_bad_plug_in_is_one_line_before_anything_runs(package, parts, values, said):
    package("scorers", *parts)
    with pytest.raises(UserError) as error:
        short(**values)
    assert said in str(error.value) and "\n" not in str(error.value)


def raises(error):
    def planner(*_):
        raise error

    return planner


def changing(terms, pool, config):
    pool.positions_m[0] = 0.0


@pytest.mark.parametrize(
    ("term", "said"),
    [
        (lambda terms, pool, config: np.full(len(pool), np.nan), "returned NaN or infinity"),
        (lambda terms, pool, config: pool.positions_m, "one number for each candidate"),
        (lambda terms, pool, config: None, "returned NaN or infinity|one number for each candidate"),
        (lambda terms, pool, config: 1 / 0, "ZeroDivisionError"),
        (raises(SystemExit(3)), "SystemExit: 3"),
        (raises(MissionFailure("disk_full", "not me")), "MissionFailure: not me"),
        (changing, "must not change what it is given"),
    ],
)
def test_a_scorer_that_fails_is_a_failed_mission(package, term, said):
    plugins.register("scorers", "bad", Scorer("bad", term, weights=lambda config: Weights()))
    mission = flown("bad")
    assert (mission.status, mission.reason) == ("failed", "plugin_failed")
    assert any(part in mission.message for part in said.split("|"))
    raised = (
        f"plug-in {__name__} raised" in mission.message and f"({Path(__file__).name}, line" in mission.message
    )
    assert raised or "scorer 'bad'" in mission.message


def flown(kind, **more):
    return run_geometric_mission(short(**{"gate.kind": kind}), "slab-3", **more)


def register_gate(name, decide):
    plugins.register("gates", name, type(name, (Gate,), {"decide": decide}))


def moving(gate, state, pool, rankings):
    """Reaches the planner's own pool through the stack, as no copy can prevent."""
    frame = sys._getframe()
    while frame.f_code.co_name != "plan":
        frame = frame.f_back
    object.__setattr__(frame.f_locals["pool"], "positions_m", np.full((len(pool), 3), 0.05))
    return GateDecision(rankings["covis"], "moved")


@pytest.mark.parametrize(
    ("decide", "said"),
    [
        (lambda gate, state, pool, ranked: ranked["covis"].scores.fill(0.0), "must not change what"),
        (lambda gate, state, pool, ranked: ranked["predicted"].terms["main"].fill(0.0), "must not change"),
        (lambda gate, state, pool, ranked: None, "returned NoneType, no"),
        (moving, "to (0.05, 0.05, 0.05), out of the pool"),
    ],
)
def test_a_gate_that_fails_is_a_failed_mission(package, decide, said):
    register_gate("bad", decide)
    mission = flown("bad")
    assert (mission.reason, mission.costs["images"]) == ("plugin_failed", 24.0)
    assert said in mission.message


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
    with pytest.raises(UserError, match="registered in a script or notebook itself"):
        plugins.plugin_specs()
    with pytest.raises(UserError, match="cannot be imported"):
        plugins.use("no_such_module")
    with pytest.raises(UserError, match=r"--plugin no_such\.py: there is no such file"):
        plugins.use("no_such.py")
    (tmp_path / "faceless.py").write_text(
        "from nbv.plugins import register\nregister('scorers', 'a', object())\n"
    )
    with pytest.raises(UserError, match=r"^scorer 'a' of faceless is no scorer: an object without main_term"):
        plugins.use(str(tmp_path / "faceless.py"))
    (tmp_path / "registers_nothing.py").write_text("")
    with pytest.raises(UserError, match="registers_nothing registers nothing"):
        plugins.use(str(tmp_path / "registers_nothing.py"))
    (tmp_path / "json.py").write_text("")
    with pytest.raises(UserError, match=r"another module is called json .* rename the file"):
        plugins.use(str(tmp_path / "json.py"))
    with pytest.raises(UserError, match="there is no group 'planners'"):
        plugins.register("planners", "a", None)
    with pytest.raises(UserError, match="settings must be a frozen dataclass"):
        bad = SimpleNamespace(main_term=0, weights=0, rank=0, settings=Section())
        plugins.register("scorers", "b", bad)


def test_a_script_may_register_a_part_and_fly_it(tmp_path):
    (tmp_path / "script.py").write_text(
        MINE
        + """
from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.plugins import register

register("scorers", "mine-low", LOW)
config = preset("campaign").with_values({"gate.kind": "mine-low", "stop.adaptive_budget": 2})
mission = run_geometric_mission(config, "slab-3")
print(mission.status, *mission.provenance["plugins"], config.digest())
"""
    )
    runs = [
        subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True) for _ in "12"
    ]
    assert runs[0].stdout.startswith("ok scorers/mine-low"), runs[0].stderr
    assert runs[0].stdout == runs[1].stdout


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ('{"scores": [-z for z in heights]}', ""),
        ('{"view": state["pool"]["ids"][3]}', ""),
        ('{"view": "nowhere"}', "names no view of the pool"),
        ('{"view": "x" * 900_000}', "names no view of the pool"),
        ('{"view": "x" * 50_000_000}', "no usable answer (more than 1000000 bytes"),
        ('{"view": "a"}) + "\\n" + json.dumps({}', "no usable answer (more than one line"),
        ('{"scores": [1.0]}', "returned the shape (1,), not ("),
        ('{"scores": [float("nan") for z in heights]}', "no usable answer (JSON is malformed"),
        ('{"scores": ["high" for z in heights]}', "no usable answer (Expected `float`, got `str`"),
        ('{"scores": [[z, z] for z in heights]}', "no usable answer (Expected `float`, got `array`"),
        ('{"scores": None}', "names no view of the pool"),
        ('{"scores": 3}', "no usable answer (Expected `array | null`, got `int`"),
        ("[1, 2]", "no usable answer (Expected `object`, got `array`"),
        ('time.sleep(20) or {"view": state["pool"]["ids"][3]}', "no usable answer (killed after 1 s)"),
        ("sys.exit(3)", "no usable answer (exit status 3)"),
    ],
)
def test_a_planner_in_another_process(package, tmp_path, monkeypatch, answer, said):
    monkeypatch.setattr(external, "ANSWER_S", 1.0 if "sleep" in answer else 30.0)
    (tmp_path / "planner.py").write_text(PROGRAM.replace("{ANSWER}", answer))
    command = f"{sys.executable} {tmp_path / 'planner.py'}"
    external.bring(f"outside=sh -c '{command}; true'" if "sleep" in answer else f"outside={command}")
    mission = flown("outside")
    assert said in mission.message and len(mission.message) < 600
    assert "planner.py" in mission.message or said in ("", "returned the shape (1,), not (")
    assert (mission.status == "failed") == bool(said)
    if not said:
        assert {capture.scorer for capture in mission.trace} == {"outside"}
    with pytest.raises(UserError, match="two gates are called 'outside'"):
        external.bring(f"outside={sys.executable} -c pass")
    with pytest.raises(UserError, match="there is no program 'no-such-program'"):
        external.bring("a=no-such-program")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frontier-density", "fisher-information"])
def test_the_planners_of_the_examples_plan(package, monkeypatch, name):
    folder = name.replace("-", "_")
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs/examples" / folder)
    package("scorers", (name, f"gatetune_{folder}:PLANNER"))
    mission = flown(name)
    assert {capture.scorer for capture in mission.trace} == {name}, mission.message
    assert all(0.0 < capture.top[name]["main"] <= 1.0 for capture in mission.trace)


def test_a_gate_that_is_none_or_cannot_be_made_is_said(package, tmp_path):
    with pytest.raises(UserError, match=r"gate 'undecided' of .* is no gate: a class without decide"):
        plugins.register("gates", "undecided", type("Undecided", (Gate,), {}))
    unbuilt = {"__init__": raises(OSError("no such map")), "decide": moving}
    plugins.register("gates", "unbuilt", type("Unbuilt", (Gate,), unbuilt))
    config = short(**{"gate.kind": "unbuilt"})
    run_job(MissionJob("a", config, "slab-3", 0, tmp_path / "a", fidelity="geometric").to_dict())
    failed = MissionResult.load(tmp_path / "a")
    assert failed.reason == "plugin_failed" and "raised OSError: no such map (" in failed.message


def last(gate, state, pool, rankings):
    scores = np.arange(len(pool), dtype=float)
    return GateDecision(Ranking("last", np.arange(len(pool))[::-1], scores, {"main": scores}), "last")


class Reaching(Gate):
    """Moves every candidate into the rock: in what it is given, behind it, and in what it finds on the way to the planner."""

    def decide(self, state, pool, rankings):
        arrays = [pool.positions_m, rankings._pool.positions_m, state.visited_m, state.model.points_m]
        arrays += [rankings["covis"].order, rankings["covis"].scores, rankings._terms.visited_m]
        for array in arrays:
            assert not isinstance(array.base, np.ndarray)
            with pytest.raises(ValueError, match="WRITEABLE"):
                array.flags.writeable = True
            ctypes.memset(array.ctypes.data, 0, array.nbytes)
        object.__setattr__(pool, "positions_m", np.zeros((len(pool), 3)))
        object.__setattr__(self.config.stop, "adaptive_budget", 10**6)
        return last(self, state, pool, rankings)


def test_what_a_planner_does_to_its_copies_reaches_nobody(package, tmp_path):
    plugins.register("gates", "reaching", Reaching)
    register_gate("last", last)
    samples = []
    for kind in ("last", "reaching"):
        mission = flown(kind, directory=tmp_path / kind, keep="all")
        assert mission.status == "ok" and len(mission.trace) == 2, mission.message
        samples.append(json.loads((tmp_path / kind / "flight.json").read_text())["samples"])
    assert samples[0] == samples[1]


def test_a_planner_is_not_told_which_rock_it_is(package):
    plugins.register("gates", "reaching", Reaching)
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
