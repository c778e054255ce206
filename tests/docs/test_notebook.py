"""The notebook of the tutorial runs from top to bottom."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "tutorial.ipynb"


def test_no_outputs_are_committed() -> None:
    cells = nbformat.read(NOTEBOOK, 4).cells
    kept = [cell.id for cell in cells if cell.cell_type == "code" and (cell.outputs or cell.execution_count)]
    assert not kept, "run: jupyter nbconvert --clear-output --inplace docs/tutorial.ipynb"


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
