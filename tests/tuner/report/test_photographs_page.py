"""The page of an imported set says what was found and what can be asked."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_photograph_set import write_set

from tuner.report.photographs import write_import_report


def test_the_page_says_what_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    page = write_import_report(write_set())
    assert page == tmp_path / "photographs" / "mine" / "report.html"
    text = page.read_text()
    assert "6 of 7 photographs make one model" in text
    assert "between azimuth 200° and 0°: nobody stood there" in text
    assert "Elevations of 0° to 0°" in text or "Elevations of -0° to 0°" in text
    assert "LOST.JPG" in text
    assert "azimuth 60° to 90°: hardly any points" in text
    assert "0.598 m" in text
    assert text.count("<img") == 2
    assert "54.5" in text
