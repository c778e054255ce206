"""Pictures of page, viewer and terminal are not older than what they show."""

import runpy
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SCREENSHOTS = runpy.run_path(str(ROOT / "docs" / "make_screenshots.py"))


@pytest.mark.parametrize("name", SCREENSHOTS["MADE_FROM"])
def test_pictures_show_what_is_there(name: str) -> None:
    with Image.open(ROOT / "docs" / "images" / f"{name}.png") as picture:
        held = picture.info.get(SCREENSHOTS["DIGEST"])
    assert held == SCREENSHOTS["digest"](name), (
        "run python docs/make_screenshots.py and look at the pictures; or, where it does not show, with --same"
    )
