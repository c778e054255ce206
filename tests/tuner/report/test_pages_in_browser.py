import dataclasses
from pathlib import Path

import fake_campaigns
import pytest
from browser import needs_chromium, opened
from made_evaluations import made_facts, made_run

from nbv.config import preset
from nbv.geometric import run_geometric_mission
from tuner.problem.space_files import load_search_space
from tuner.report.campaign_page import write_campaign_report
from tuner.report.comparison import write_comparison_report
from tuner.report.mission_view import write_mission_view

WIDTHS = (420, 1200)


def campaign_page(folder: Path) -> Path:
    space = load_search_space("gate")
    return write_campaign_report(fake_campaigns.run(folder / "run", space=space, sampler="sobol", budget=6))


def evaluation_page(folder: Path) -> Path:
    names = ("tuned", "hyb-h", "hyb-o", "covis", "b-aware", "predicted", "random")
    run = made_run({name: 60.0 - i for i, name in enumerate(names)}, rocks=("arch", "fin"), replicates=3)
    return write_comparison_report(made_facts(dataclasses.replace(run, directory=folder)))


def mission_page(folder: Path) -> Path:
    config = preset("campaign").with_values({"stop.adaptive_budget": 2})
    run_geometric_mission(config, "slab", 0, folder / "first")
    return write_mission_view([folder / "first"], folder / "view.html")


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("make", [campaign_page, evaluation_page, mission_page])
def test_a_page_opens_without_an_error_at_both_widths(make, tmp_path: Path) -> None:
    said, needed = opened(make(tmp_path).read_text(), WIDTHS)
    assert said == []
    assert set(needed) == set(WIDTHS) and all(needed[width] <= width for width in WIDTHS)
