"""``gatetune photographs``: list, the page of a set, and mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from made_photograph_set import write_set
from typer.testing import CliRunner

from nbv.errors import UserError
from tuner.cli import app
from tuner.report.photographs import write_import_report

run = CliRunner()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    return tmp_path


def test_sets_are_listed() -> None:
    write_set()
    listed = json.loads(run.invoke(app, ["photographs", "list", "--json"]).output)
    assert [(s["name"], s["registered"], s["photographs"]) for s in listed] == [("mine", 6, 7)]
    assert listed[0]["height_m"] == pytest.approx(0.598)
    assert listed[0]["weak"][0].startswith("azimuth 60°")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["enough", "yours"], "no set of photographs 'yours'"),
        (["import", "absent", "--name", "yours"], "there is no folder absent"),
        (["import", ".", "--name", "mine"], "already a set 'mine'"),
        (["import", ".", "--name", "yours", "--max-size", "7"], "max_size is 7"),
        (["import", ".", "--name", "yours", "--height-m", "0"], "height_m is 0"),
    ],
)
def test_mistakes(arguments: list[str], words: str) -> None:
    write_set()
    told = run.invoke(app, ["photographs", *arguments])
    assert isinstance(told.exception, UserError)
    assert words in str(told.exception)


def test_the_page_of_an_imported_set_says_what_there_is(home: Path) -> None:
    page = write_import_report(write_set())
    assert page == home / "photographs" / "mine" / "report.html"
    text = page.read_text()
    assert "6 of 7 photographs make one model" in text
    assert "between azimuth 200° and 0°: none was taken there" in text
    assert "Elevations of 0° to 0°" in text or "Elevations of -0° to 0°" in text
    assert "LOST.JPG" in text
    assert "azimuth 60° to 90°: hardly any points" in text
    assert "0.598 m" in text
    assert text.count("<img") == 2
    assert "54.5" in text
