"""What the README, the tutorial and the how-to pages show runs, line after line, on what the line before left."""

import re
import shutil
from pathlib import Path

import pytest
import trimesh
from street import ROOT, SMALL, Street, commands_of

pytestmark = pytest.mark.slow

# What the page's reader has: a scan of their own.
SCANS = ("scan.obj", "other.obj", "path/to/apollo_15016.obj")
PAGES = {
    "README.md": {},
    "docs/tutorial.md": {},
    "docs/how-to/own-rock.md": {},
    "docs/how-to/own-space.md": {"budget": "24"},  # fewer missions are refused by a warm start
    "docs/how-to/objectives.md": {},
    "docs/how-to/conditions.md": {},
}


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_runs(page, tmp_path):
    text = (ROOT / page).read_text()
    lines = [line for line in commands_of(ROOT / page) if re.search(r"runs/|--", line)]
    assert lines, page
    for file in SCANS:
        if file in text:
            scan(tmp_path / file, bumps=SCANS.index(file) + 2)
    for name, block in re.findall(r"```yaml\n(.*?)```.*?(\w+\.yaml)", text, re.DOTALL):
        (tmp_path / block).write_text(name)
    if "SPACE.yaml" in text:
        shutil.copy(ROOT / "search_spaces/photographs.yaml", tmp_path / "SPACE.yaml")
    street = Street(
        tmp_path, SMALL | {"against": "hyb-h"} | PAGES[page]
    )  # one baseline, where a page names none
    if (
        "gatetune evaluate runs/tune" in text
    ):  # what `make tune` leaves, which test_make_tune_walked runs whole
        street.run("gatetune campaign run --name tune --rock slab --rock cavern")
    for line in lines:
        street.run(line)


def scan(path: Path, bumps: int) -> None:
    """A lump of 12 cm, as somebody might have scanned it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.06)
    x, y, z = mesh.vertices.T / 0.06
    mesh.vertices *= (1 + 0.1 * (x * y * bumps + z * z))[:, None] * (1.0, 0.8, 0.7)
    mesh.export(path)
