"""What the README, the tutorial, the how-to pages and the Makefile show runs, line after line, and so does what a screen then tells."""

import json
import re
import shutil
from pathlib import Path

import pytest
import trimesh
import yaml
from street import ROOT, SMALL, Street, commands_of, commands_on

from nbv.config import config_from_dict
from tuner.campaign.campaign import Campaign

pytestmark = pytest.mark.slow

# What the page's reader has: a scan of their own.
SCANS = ("scan.obj", "other.obj", "path/to/apollo_15016.obj")
PAGE = SMALL | {"against": "hyb-h"}  # one baseline, where a page names none
PAGES = {
    "README.md": PAGE,
    "docs/tutorial.md": PAGE,
    "docs/how-to/own-rock.md": PAGE,
    "docs/how-to/own-space.md": PAGE
    | {"budget": "24", "sampler": "sobol"},  # fewer are refused by a warm start
    "docs/how-to/objectives.md": PAGE,
    "docs/how-to/conditions.md": PAGE,
}


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_runs(page, tmp_path):
    text = (ROOT / page).read_text()
    lines = [
        line for line in dict.fromkeys(commands_of(ROOT / page)) if re.search(r"runs/|--|mission ", line)
    ]
    assert lines, page
    for file in SCANS:
        if file in text:
            scan(tmp_path / file, bumps=SCANS.index(file) + 2)
    for name, block in re.findall(r"```yaml\n(.*?)```.*?(\w+\.yaml)", text, re.DOTALL):
        (tmp_path / block).write_text(name)
    if "SPACE.yaml" in text:
        shutil.copy(ROOT / "search_spaces/photographs.yaml", tmp_path / "SPACE.yaml")
    street = Street(tmp_path, PAGES[page])
    if "gatetune evaluate runs/tune" in text:  # what `make tune` leaves
        street.run("gatetune campaign run --name tune --rock slab")
    for line in lines:
        street.run(line)


@pytest.mark.parametrize(("target", "budget"), [("tune", "16"), ("tune-photographs", "8")])
def test_from_a_target_of_the_makefile_to_every_command_that_it_names(target, budget, tmp_path):
    street = Street(tmp_path, SMALL | {"budget": budget})
    terminal = "".join(street.run(line) for line in recipe(target, "tune"))
    page = street.file("runs/tune/report.html")
    answer = json.loads(street.run("gatetune campaign status runs/tune --json"))["answer"]
    recommended = same_everywhere(street, answer)
    lines = list(dict.fromkeys(commands_on(terminal) + commands_on(page)))
    assert lines, "the page says what to do next"
    for line in lines:
        street.run(line)
    plans = [yaml.safe_load(path.read_text()) for path in tmp_path.glob("runs/tune/*/evaluation.yaml")]
    for name, digest in recommended.items():
        evaluated = [plan["strategies"][name] for plan in plans if name in plan["strategies"]]
        assert {config_from_dict(tree).digest() for tree in evaluated} <= {digest}


def recipe(target: str, name: str) -> list[str]:
    """The command lines of a target of the Makefile, for a run of this name."""
    lines = re.sub(r"\\\n\s*", " ", (ROOT / "Makefile").read_text())
    commands = re.search(rf"^{target}: setup\n((?:\t.*\n)+)", lines, re.MULTILINE)[1]
    return re.findall(r"gatetune .*", commands.replace("$(RUN)-photographs", name).replace("$(RUN)", name))


def same_everywhere(street: Street, answer: dict) -> dict[str, str]:
    """The same values in answer, file, Python and every export; the digest of each tuned configuration by its name."""
    values = {name: best["values"] for name, best in answer["recommended"].items()}
    saved = json.loads(street.file("runs/tune/recommendation.json"))
    assert values == {name: best["values"] for name, best in saved.items()}
    campaign = Campaign.open(street.folder / "runs/tune", read_only=True)
    assert values == {name: best.values for name, best in campaign.recommendations(save=False).items()}
    name = list(values)[-1]
    street.run("gatetune export runs/tune")
    for to in ("gatetune.yaml", f"plan --home 47.4,8.5 --rock {campaign.settings.rocks[0]}"):
        street.run(f"gatetune export runs/tune --strategy {name} --to {to}")
    exported = config_from_dict(yaml.safe_load(street.file("runs/tune/gatetune.yaml")))
    s = campaign.settings
    assert exported.digest() == s.problem.config(values[name], s.conditions[0].name).digest()
    return {each: campaign.recommended_config(each).digest() for each in values}


def scan(path: Path, bumps: int) -> None:
    """A lump of 12 cm, as somebody might have scanned it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.06)
    x, y, z = mesh.vertices.T / 0.06
    mesh.vertices *= (1 + 0.1 * (x * y * bumps + z * z))[:, None] * (1.0, 0.8, 0.7)
    mesh.export(path)
