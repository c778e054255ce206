"""The rules of the house that no linter knows."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


# Files that read what this program wrote for itself: pipes between its processes, its store, its own defaults.
OWN_WORDS = {
    "nbv/cache",
    "nbv/config/conditions.py",
    "nbv/config/mission_config.py",
    "nbv/safe_files.py",
    "tuner/campaign/ledger.py",
}


def test_files_are_read_at_one_boundary() -> None:
    loads = "json.load json.loads yaml.load yaml.safe_load np.load pickle.load pickle.loads"
    found = []
    for path in (p for package in ("nbv", "tuner") for p in (ROOT / package).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not any(name.startswith(own) for own in OWN_WORDS):
            calls = (n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call))
            found += [f"{name}:{c.lineno}" for c in calls if ast.unparse(c.func) in loads.split()]
    assert found == [], "nbv.safe_files limits the size of a file and the kinds of values in it"


DOCKERFILE = (ROOT / ".ci" / "Dockerfile").read_text()


def test_what_it_copies_is_there_and_not_ignored() -> None:
    (copied,) = re.findall(r"^COPY (.*) \S+$", DOCKERFILE, re.M)
    kept = re.findall(r"^!(.*)$", (ROOT / ".ci" / "Dockerfile.dockerignore").read_text(), re.M)
    assert copied.split() == kept
    wheel = "python -m pip wheel --no-deps -w dist ."  # makes the one that is not in the repository
    assert wheel in DOCKERFILE and (ROOT / "constraints.txt").is_file()


def test_it_installs_the_libraries_that_the_setup_asks_for() -> None:
    (installed,) = re.findall(r"install -y --no-install-recommends (.*?)\\\s*&&", DOCKERFILE, re.S)
    asked = re.findall(r'"lib[^"]*\.so[^"]*": "([^"]+)"', (ROOT / ".ci" / "setup").read_text())
    assert asked and sorted(installed.split()) == sorted(asked)
