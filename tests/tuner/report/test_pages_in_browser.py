"""Pages opened in headless Chromium: nothing on the console, and nothing wider than the window."""

import dataclasses
import re
import shutil
import subprocess
from pathlib import Path

import fake_campaigns
import pytest
from made_evaluations import made_facts, made_run

from nbv.config import preset
from nbv.geometric import run_geometric_mission
from tuner.problem.space_files import load_search_space
from tuner.report.campaign_page import write_campaign_report
from tuner.report.comparison import write_comparison_report
from tuner.report.mission_view import write_mission_view

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--enable-logging=stderr",
    "--virtual-time-budget=10000",
    "--dump-dom",
]
GRAPHICS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WIDTHS = (420, 1200)
# A frame each, for Chromium makes no window as narrow as a telephone.
FRAME = '<iframe src="{}" width="{}" height="1500" style="border:0"></iframe>'
MEASURE = (
    "<script>addEventListener('load', () => setTimeout(() => "
    "console.log('WIDTHS', location.pathname, innerWidth, document.documentElement.scrollWidth), 200))</script>"
)


def campaign_page(folder: Path) -> Path:
    space = load_search_space("gate")
    return write_campaign_report(fake_campaigns.run(folder / "run", space=space, sampler="sobol", budget=6))


def evaluation_page(folder: Path) -> Path:
    names = ("tuned", "hyb-h", "hyb-o", "covis", "b-aware", "predicted", "random")
    run = made_run({name: 60.0 - i for i, name in enumerate(names)}, rocks=("arch", "fin"), replicates=3)
    return write_comparison_report(made_facts(dataclasses.replace(run, directory=folder)))


def mission_page(folder: Path) -> Path:
    config = preset("campaign").with_values({"photographs": 26})
    run_geometric_mission(config, "slab", 0, folder / "first")
    return write_mission_view([folder / "first"], folder / "view.html")


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.slow
def test_pages_open_without_an_error_at_both_widths(tmp_path: Path) -> None:
    pages = [make(tmp_path) for make in (campaign_page, evaluation_page, mission_page)]
    for page in pages:
        page.write_text(page.read_text() + MEASURE)
    frames = tmp_path / "frames.html"
    frames.write_text("".join(FRAME.format(page, width) for page in pages for width in WIDTHS))
    command = [CHROMIUM, *OPTIONS, *GRAPHICS, f"--user-data-dir={tmp_path}/profile", frames.as_uri()]
    for _ in range(3):  # on a busy machine Chromium may end before a frame's timer
        log = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True).stderr
        said = re.findall(r'CONSOLE:\d+\] "(.*?)", source', log, re.DOTALL)
        measured = {tuple(line.split()[1:]) for line in said if line.startswith("WIDTHS ")}
        if len(measured) == len(pages) * len(WIDTHS):
            break
    assert [line for line in said if not line.startswith("WIDTHS ")] == []
    assert {(page, int(width)) for page, width, _ in measured} == {(str(p), w) for p in pages for w in WIDTHS}
    assert all(int(needed) <= int(width) for _, width, needed in measured)
