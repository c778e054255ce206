"""The page on missions of one's own: every command on it, in order, on a real program and real data."""

import shutil

import pytest
import yaml
from street import OWN, ROOT, Street, commands_on

from tuner.campaign.campaign import Campaign

PAGE = ROOT / "docs/how-to/your-mission.md"


@pytest.mark.slow
def test_every_command_of_the_page_runs(tmp_path):
    if shutil.which("xz") is None:
        pytest.skip("xz is absent: apt install xz-utils")
    lines = [line.strip() for line in PAGE.read_text().splitlines() if line.startswith("    gatetune ")]
    assert len(lines) == 7
    street = Street(tmp_path, {})
    for line in lines:
        assert "Hausdorff" not in street.run(line)
    street.small = OWN
    for line in commands_on(street.file("runs/packing/report.html")):
        street.run(line)
    campaign = Campaign.open(tmp_path / "runs/packing", read_only=True)
    trials = campaign.trials()
    best = campaign.recommendation(save=False)
    # Heights are of two bytes each: their differences at distance 2 pack best, by a sixth.
    assert best.values["delta"] == 2 and best.improvement > 5
    assert {t.reason for t in trials if t.state == "failed"} <= {"refused"}
    assert {t.rock for t in trials} == {"north", "south"}
    evaluated = {path.name for path in (campaign.directory / "evaluation/missions").iterdir()}
    assert evaluated == {"tuned", "default", "thorough"}
    page = street.file("runs/packing/evaluation/report.html")
    assert "Table I" not in page and "dense clouds" not in page
    assert yaml.safe_load(street.file("runs/packing/gatetune.yaml")) == best.values
