"""Every example of docs/extend.md is what it says: one new file, one line, and it works."""

import importlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
BLOCK = re.compile(r'^```python title="([^"]*)"\n(.*?)^```$', re.DOTALL | re.MULTILINE)
PLAIN_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def examples():
    """(heading, [(title, code)]) of every section with code."""
    sections = re.split(r"^## ", (ROOT / "docs/extend.md").read_text(), flags=re.MULTILINE)[1:]
    found = [(section.splitlines()[0], BLOCK.findall(section)) for section in sections]
    return [(heading, blocks) for heading, blocks in found if blocks]


PARTS = [example for example in examples() if not example[0].startswith("A setting")]
SETTINGS = [example for example in examples() if example[0].startswith("A setting")]


def add_file(title, code, folder, monkeypatch):
    """The new file under the module name that its place would give it."""
    assert not (ROOT / title).exists(), f"{title} is there already"
    name = title.removesuffix(".py").replace("/", ".")
    file = folder / Path(title).name
    file.write_text(code)
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, module)
    spec.loader.exec_module(module)
    return module


def add_line(title, line, new_module, monkeypatch):
    """The line in the registry that the title names: "file, REGISTRY"."""
    file, registry_name = title.split(", ")
    assert (ROOT / file).is_file()
    module = importlib.import_module(file.removesuffix(".py").replace("/", "."))
    assert line.strip().count("\n") == 0, "one line"
    if line.startswith('"'):
        entries = eval(f"{{{line}}}")
    else:  # of a table of metrics
        metric = eval(line, {**vars(module), **vars(new_module)})
        entries = {metric.key: metric}
    for name, entry in entries.items():
        monkeypatch.setitem(getattr(module, registry_name), name, entry)


@pytest.mark.slow
@pytest.mark.parametrize(("heading", "blocks"), PARTS, ids=[heading for heading, _ in PARTS])
def test_an_example_works_as_one_file_and_one_line(heading, blocks, tmp_path, monkeypatch):
    (new_file, code), (registry, line), (trial, check) = blocks
    assert trial == "try it" and "assert" in check
    module = add_file(new_file, code, tmp_path, monkeypatch)
    add_line(registry, line, module, monkeypatch)
    exec(compile(check, f"extend.md, {heading}", "exec"), {})


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


def test_every_kind_of_part_has_an_example():
    kinds = {"scorer", "gate", "renderer", "dense backend", "metric", "sampler", "fidelity"}
    kinds |= {"setting of the mission", "setting of a campaign"}
    assert {heading.removeprefix("A ") for heading, _ in examples()} == kinds


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md"])
def test_python_on_a_page_runs(page, capsys):
    for code in PLAIN_BLOCK.findall((ROOT / page).read_text()):
        exec(compile(code, page, "exec"), {})
    assert float(capsys.readouterr().out) > 50.0  # an F-score in percent
