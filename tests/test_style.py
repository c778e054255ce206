"""Rules of style that ruff is not asked for."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_module_says_what_it_is_for() -> None:
    files = [path for package in ("nbv", "tuner") for path in (ROOT / package).rglob("*.py")]
    silent = [str(p.relative_to(ROOT)) for p in files if not ast.get_docstring(ast.parse(p.read_text()))]
    assert silent == [], "CONTRIBUTING.md: a docstring says what a package is for"
