"""The rules of the house that no linter knows."""

import ast
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
