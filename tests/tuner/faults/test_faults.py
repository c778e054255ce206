"""A few of the faults of `make faults`, a seeded share of `make fuzz` and all that it ever found.

Nothing is lost, run twice or charged, files are read or refused in one line, and nobody sees a traceback.
"""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

from research import fuzz

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_a_few_faults_do_no_harm(tmp_path: Path) -> None:
    asked = ["--small", "--count", "3", "--kind", "coordinator's writes from the Nth on", "--out", tmp_path]
    command = [sys.executable, "-m", "research.faults", *map(str, asked)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    *_, total = csv.DictReader((tmp_path / "faults.csv").open(newline=""))
    assert int(total["faults"]) >= 2
    for harm in ("traceback", "hang", "lost", "repeated", "charged"):
        assert total[harm] == "0", harm


QUICK = ("settings file", "condition", "configuration", "mission.json", "store entry")
LEFT = {"command line", "mesh PLY", "mesh STL", "texture"}  # to `make fuzz`
CASES = {t: 20 if t in QUICK else 3 if t == fuzz.DISK else 5 for t in fuzz.TARGETS if t not in LEFT}
FOUND = sorted(path for path in fuzz.CORPUS.rglob("*") if path.is_file())


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    home = os.environ["GATETUNE_HOME"]
    try:
        fuzz.make_seeds(folder)
    finally:
        os.environ["GATETUNE_HOME"] = home
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("target", CASES)
def test_damaged_files_are_read_or_refused(target: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(place / "home"))
    assert fuzz.run_case(target, fuzz.case(target, 0), place) == ("read", ""), "a sound file is read"
    for number in range(len(fuzz.SEEDS[target]), len(fuzz.SEEDS[target]) + CASES[target]):
        outcome, what = fuzz.run_case(target, fuzz.case(target, number), place)
        assert outcome in ("read", "refused"), what


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_was_found_is_read_or_refused(path, tmp_path, monkeypatch):
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    target = next(t for t in fuzz.TARGETS if fuzz.folder_of(t) == path.parent.name)
    outcome, what = fuzz.run_case(target, path.read_bytes(), tmp_path)
    assert outcome in ("read", "refused"), what
