"""The notebook runs from top to bottom; pictures of page, viewer and terminal are not older than what they show."""

import runpy
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs" / "tutorial.ipynb"


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(NOTEBOOK.parents[1]))  # a clone that is not installed
    book = nbformat.read(NOTEBOOK, 4)
    NotebookClient(book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    said = [
        "".join(output.get("data", {}).get("text/plain", "") for output in cell.outputs)
        for cell in book.cells
        if cell.cell_type == "code"
    ]
    assert said[0].startswith("('ok', ")
    assert "tuned" in said[5] and "hyb-h" in said[5]
    assert "covis" in said[6] and "b-aware" in said[6]
    assert (tmp_path / "runs" / "notebook" / "mission.html").stat().st_size > 100_000


SCREENSHOTS = runpy.run_path(str(ROOT / "docs" / "make_screenshots.py"))


@pytest.mark.parametrize("name", SCREENSHOTS["MADE_FROM"])
def test_pictures_show_what_is_there(name: str) -> None:
    with Image.open(ROOT / "docs" / "images" / f"{name}.png") as picture:
        held = picture.info.get(SCREENSHOTS["DIGEST"])
    assert held == SCREENSHOTS["digest"](name), (
        "run python docs/make_screenshots.py and look at the pictures; or, where it does not show, with --same"
    )
