"""``gatetune plugin``: the package that it writes works, and what is installed is listed."""

import json
import os
import subprocess
import sys
from importlib import metadata

import pytest
from typer.testing import CliRunner

from nbv import plugins
from nbv.errors import UserError
from tuner.cli import app


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
    with pytest.raises(UserError, match="cannot name a plug-in"):
        gatetune("plugin", "init", "Mine!")
    for taken in ("random", "pool"):
        with pytest.raises(UserError, match=f"'{taken}' is already the name of a strategy or section"):
            gatetune("plugin", "init", taken, "--out", tmp_path / taken)
    with pytest.raises(UserError, match="exists"):
        gatetune("plugin", "init", "mine", "--out", tmp_path)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [])
    monkeypatch.setattr(plugins, "_registered", {})
    plugins.installed.cache_clear()
    assert "no plug-in is installed" in gatetune("plugin", "list")
    plugins.installed.cache_clear()


def test_a_package_that_takes_a_built_in_name_is_one_line_and_commands_go_on(tmp_path):
    folder = tmp_path / "thief-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: thief\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[gatetune.samplers]\ngp = nothing:GP\n")
    path = os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])
    command = [sys.executable, "-m", "tuner.cli", "plugin", "list"]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout
    (line,) = done.stderr.splitlines()
    assert line.startswith("note: sampler 'gp' of thief 1.0 has the name of one that is built in")
