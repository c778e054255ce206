"""Pages of results, each with its command and data; the prediction's calibration against recorded states."""

import csv
import importlib
import re
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from nbv.scorers.prediction import CALIBRATION
from research.other_shapes import KEPT, LATER
from research.predict_completeness import TOLD_FROM, column, features, fit, percent

ROOT = Path(__file__).resolve().parent.parent.parent
RESULTS = ROOT / "docs" / "results"
DATA = RESULTS / "data"
SOURCES = list(csv.DictReader((DATA / "sources.csv").open(newline="", encoding="utf-8")))
PAGES = sorted(RESULTS.glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_scripts_of_a_page_exist(page):
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m (research[.\w]*)", text):
        path = ROOT / module.replace(".", "/")
        there = path.is_dir() or path.with_suffix(".py").is_file()
        line = next(line for line in text.splitlines() if f"python -m {module}" in line)
        assert there or "git checkout" in line, module


def test_every_section_of_the_appendix_has_a_command():
    _, *sections = (RESULTS / "index.md").read_text(encoding="utf-8").split("\n## ")
    assert sections
    for section in sections:
        assert re.search(r"^    (gatetune|python|make|git) ", section, re.M), section.splitlines()[0]


def test_every_table_of_data_has_a_page_a_commit_and_a_command():
    files = {path.name for path in DATA.glob("*.csv")} - {"sources.csv"}
    assert {row["file"] for row in SOURCES} == files
    for row in SOURCES:
        assert row["commit"] and row["command"], row["file"]
        for page in row["page"].split(", "):
            assert (RESULTS / page).is_file(), (row["file"], page)


@pytest.mark.parametrize("path", sorted(DATA.glob("*.csv")), ids=lambda path: path.stem)
def test_every_row_of_data_is_complete(path):
    head, *rows = csv.reader(path.open(newline="", encoding="utf-8"))
    assert rows and len(set(head)) == len(head)
    assert all(len(row) == len(head) for row in rows)


@pytest.mark.parametrize("path", sorted((ROOT / "research").glob("**/*.py")), ids=lambda path: path.stem)
def test_a_script_imports_what_exists(path):
    importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))


def test_pages_that_the_code_names_exist():
    files = [
        path
        for folder in ("nbv", "tuner", "search_spaces")
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".yaml")
    ]
    named = {
        page for path in files for page in re.findall(r"\bdocs/[\w/-]+\.md", path.read_text(encoding="utf-8"))
    }
    assert named and not [page for page in named if not (ROOT / page).is_file()]


def states(name):
    with (DATA / name).open() as file:
        return list(csv.DictReader(file))


def test_the_calibration_is_the_fit_of_the_training_states():
    assert np.round(fit(states("predicted_completeness.csv")), 2) == pytest.approx(astuple(CALIBRATION))


def test_on_shapes_that_nothing_was_fitted_to_it_is_seldom_too_high_and_done_means_done():
    rows = [row for row in states("other_shapes.csv") if int(row["photographs"]) >= TOLD_FROM]
    assert {row["rock"] for row in rows} == {make.__name__ for make in (*KEPT, *LATER)}
    completeness = 1.0 / (1.0 + np.exp(-features(rows) @ astuple(CALIBRATION)))
    told, real = 200.0 * completeness / (1.0 + completeness), percent(rows, "completeness")
    assert (told - real > 5.0).mean() <= 0.05
    assert (real[told >= 98.0] >= 97.0).mean() >= 0.95
    assert column(rows, "predicted") == pytest.approx(completeness, abs=1e-3)
