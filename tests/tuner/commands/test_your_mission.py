"""The page on missions of one's own: every command on it, in order, on a real program and real data."""

import shlex
import shutil
from pathlib import Path

import pytest
import yaml

from tests.support.street import OWN, Street, commands_on
from tuner.campaign import Campaign

PAGE = Path(__file__).resolve().parents[3] / "docs/how-to/your-mission.md"
COMMANDS = [line.split()[1:] for line in PAGE.read_text().splitlines() if line.startswith("    gatetune ")]


@pytest.mark.slow
def test_every_command_of_the_page_runs(gatetune, tmp_path):
    if shutil.which("xz") is None:
        pytest.skip("xz is absent: apt install xz-utils")
    assert [words[0] for words in COMMANDS] == [
        "mission",
        "mission",
        "campaign",
        "campaign",
        "confirm",
        "evaluate",
        "export",
    ]
    for words in COMMANDS:
        code, out, err = gatetune(*words)
        assert code == 0, f"{shlex.join(words)}: {out}{err}"
        assert "Hausdorff" not in out
    street = Street(tmp_path, OWN, own_home=False)
    for line in commands_on((tmp_path / "runs/packing/report.html").read_text()):
        street.run(line)
    campaign = Campaign.open(tmp_path / "runs/packing", read_only=True)
    trials = campaign.trials()
    best = campaign.recommendation(save=False)
    # Heights are of two bytes each: their differences at distance 2 pack best, by a sixth.
    assert best.values["delta"] == 2 and best.improvement > 5
    assert {t.reason for t in trials if t.state == "failed"} <= {"refused"}
    assert {t.rock for t in trials} == {"north", "south"}
    flown = {path.name for path in (campaign.directory / "evaluation/missions").iterdir()}
    assert flown == {"tuned", "default", "thorough"}
    page = (campaign.directory / "evaluation/report.html").read_text()
    assert not [
        words for words in ("Table I", "dense clouds", "simulated flight", "improvement ()") if words in page
    ]
    assert yaml.safe_load((campaign.directory / "gatetune.yaml").read_text()) == best.values
