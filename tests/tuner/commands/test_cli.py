import errno
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import yaml

from nbv import plugins
from tuner.cli import main

RUN = "campaign run --rock boulder"


@pytest.mark.slow
@pytest.mark.parametrize(
    "command, says",
    [
        (f"{RUN} --budget 1000000000", "the limit is 100000 (GATETUNE_LIMITS=10 raises"),
        (f"{RUN} --replicates 0", "replicates"),
        (f"{RUN} --sampler magic", "magic"),
        (f"{RUN} --name ../../x", "'../../x' must be a folder name without '/'"),
        (f"{RUN} --seed {2**70}", "below 2**63"),
        (f"{RUN} --set photographs", "PATH=VALUE"),
        (f"{RUN} --objective observable.surprise", "direction: maximise"),
        ("campaign run nowhere.yaml", "nowhere.yaml"),
        ("campaign run --rock mushroom", "held out"),
        ("evaluate nowhere", "nowhere"),
        ("reproduce --strategy covi", "covis"),
        ("mission run --rock boulder --gate hyb", "hyb-h"),
        ("rocks show boulder --image nowhere/boulder.png", "nowhere/boulder.png"),
    ],
)
def test_a_mistake_is_one_line_and_runs_nothing(gatetune, tmp_path, command, says):
    assert says in gatetune.refused(*command.split(" "))
    assert not any((tmp_path / "runs").rglob("*.json"))


@pytest.mark.parametrize(
    "text, says",
    [
        ("budgit: 4\n", "did you mean 'budget'?"),
        ("budget: many\n", "budget is 'many'; it must be a whole number"),
        ("rocks: boulder\n", "rocks is 'boulder'; it must be a list"),
        ("objective: {metrik: x}\n", "an objective is a metric's path"),
        ("format: 1\nsettings: {}\n", "has format 1, this version reads"),
    ],
)
def test_a_bad_settings_file_is_named(gatetune, tmp_path, text, says):
    (tmp_path / "mine.yaml").write_text(text)
    assert says in gatetune.refused("campaign", "run", "mine.yaml", "--rock", "boulder")
    assert not (tmp_path / "runs").exists()


def test_options_beat_the_settings_file_which_beats_the_defaults(gatetune, monkeypatch, tmp_path):
    monkeypatch.setattr("tuner.commands.campaign.run_and_report", lambda *_, **__: None)
    (tmp_path / "mine.yaml").write_text(
        "name: mine\nspace: full\nbudget: 20\nrocks: [slab]\nin_step: 2\noverrides: {gate.kind: hyb-o, photographs: 33}\n"
        "second: costs.flight_time_s\nlimit: 300\n"
    )
    options = "--budget 30 --rock boulder --set photographs=28"
    out = gatetune.ok("campaign", "run", "mine.yaml", *options.split())
    assert out.splitlines()[0] == "campaign mine in runs/mine"
    found = yaml.safe_load((tmp_path / "runs/mine/campaign.yaml").read_text())["settings"]
    assert (found["budget"], found["rocks"], found["in_step"], found["replicates"]) == (30, ["boulder"], 2, 2)
    assert found["overrides"] == {"gate.kind": "hyb-o", "photographs": 28}
    assert found["second"] == {"metric": "costs.flight_time_s", "direction": "minimise"}
    # Another campaign's file will do, and changes what is asked to.
    gatetune.ok("campaign", "run", "runs/mine/campaign.yaml", "--name", "again", "--seed", "7")
    again = yaml.safe_load((tmp_path / "runs/again/campaign.yaml").read_text())["settings"]
    assert again == {**found, "name": "again", "seed": 7}


def test_the_first_line_waits_for_nothing_slow_to_load():
    heavy = {
        "torch",
        "botorch",
        "optuna",
        "matplotlib",
        "sklearn",
        "open3d",
        "pycolmap",
        "scipy.stats",
        "scipy.spatial",
    }
    loaded = "print(*(name for name, module in sys.modules.items() if 'Lazy' not in type(module).__name__))"
    program = f"import sys, tuner.cli, tuner.campaign.settings_file; {loaded}"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not heavy & set(found.stdout.split())


def test_what_nobody_foresaw_is_one_line_and_a_log(gatetune, monkeypatch, gatetune_home):
    def fail(*_):
        raise RuntimeError("a [/] thing\nnobody expected")

    monkeypatch.setattr("tuner.commands.rocks.list_rocks", fail, raising=False)
    monkeypatch.setattr("nbv.rocks.list_rocks", fail)
    code, _, err = gatetune("rocks", "list")
    log = gatetune_home / "last_error.log"
    assert code == 70 and len(err.strip().splitlines()) == 1
    assert "RuntimeError: a [/] thing nobody expected" in err and str(log) in err
    assert "Traceback" in log.read_text() and "in fail" in log.read_text()


def test_a_name_that_looks_like_markup_is_shown_as_it_is(gatetune, monkeypatch):
    monkeypatch.setattr("tuner.commands.campaign.run_and_report", lambda *_, **__: None)
    gatetune.ok(*RUN.split(), "--name", "[bold]x[]")
    assert "[bold]x[]: 0 of 64 missions" in gatetune.ok("campaign", "status", "runs/[bold]x[]")


def test_a_file_chooses_no_code(gatetune, monkeypatch, tmp_path):
    registers = "from nbv.plugins import register\nregister('fidelities', 'foreign', print)\n"
    (tmp_path / "foreign.py").write_text(registers)
    (tmp_path / "mine.yaml").write_text("fidelity: foreign\nrocks: [boulder]\n")
    monkeypatch.setattr("tuner.commands.campaign.run_and_report", lambda *_, **__: None)
    for arguments in (["run", "mine.yaml"], ["resume", "runs/campaign"], ["status", "runs/campaign"]):
        monkeypatch.setattr(plugins, "_registered", {})
        sys.modules.pop("foreign", None)
        said = gatetune.refused("campaign", *arguments)
        assert "unknown fidelity 'foreign'" in said and "--plugin" in said
        gatetune.ok("--plugin", "foreign.py", "campaign", *arguments)


@pytest.mark.parametrize(
    ("cuda", "asked", "evaluated"), [(False, (), "sgbm"), (True, (), "patchmatch"), (True, ("sgbm",), "sgbm")]
)
def test_patchmatch_is_chosen_where_there_is_cuda(gatetune, monkeypatch, cuda, asked, evaluated):
    monkeypatch.setattr("nbv.dense.reconstruct.patchmatch_runs", lambda: cuda)
    out = gatetune.ok("config", "show", *(f"--set=dense.backend={name}" for name in asked))
    assert re.search(rf"backend: {evaluated} ", out)


@pytest.mark.parametrize("command", [("mission", "run"), ("campaign", "run"), ("reproduce",)])
def test_a_dense_stage_that_cannot_run_is_refused_before_anything_is_written(gatetune, monkeypatch, command):
    monkeypatch.setattr("pycolmap.has_cuda", False)
    monkeypatch.setattr("tuner.commands.console.with_best_dense_stage", lambda values: values)
    code, _, err = gatetune(*command, "--rock", "slab", "--set", "dense.backend=patchmatch")
    assert code == 2 and 'pip install "gatetune[cuda]"' in err
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (MemoryError(), "memory ran out"),
        (OSError(errno.ENOSPC, "No space left on device"), "the disk is full"),  # as where a figure is drawn
    ],
)
def test_what_ran_out_is_one_line(error, says, monkeypatch, capsys):
    def run_out() -> None:
        raise error

    monkeypatch.setattr("tuner.cli.app", run_out)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert says in capsys.readouterr().err


def test_this_machine_can_fly(gatetune):
    out = gatetune.ok("doctor")
    assert out.splitlines()[-1] == "missions can be run here"
    assert "numpy, torch" in out and "missions at once" in out and "pruned to 10 GiB" in out


def test_the_version(gatetune):
    assert gatetune.ok("--version").strip() == f"gatetune {metadata.version('gatetune')}"
