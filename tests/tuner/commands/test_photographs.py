import json
from pathlib import Path

import pytest
from photographed_ball import write_part_of_a_set

from nbv.safe_files import read_yaml
from tuner.campaign.settings import CampaignSettings


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    return tmp_path


def test_sets_are_listed(gatetune) -> None:
    write_part_of_a_set()
    listed = json.loads(gatetune.ok("photographs", "list", "--json"))
    assert [(s["name"], s["registered"], s["photographs"]) for s in listed] == [("mine", 6, 7)]
    assert listed[0]["height_m"] == pytest.approx(0.368)
    assert listed[0]["weak"][0].startswith("azimuth 60°")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("enough yours", "no set of photographs 'yours'"),
        ("import . --name mine", "already a set 'mine'"),
        ("import . --name Mine!", "'Mine!' cannot name a set of photographs"),
        ("import . --name yours --max-size 7", "max_size is 7"),
        ("import . --name yours --metres-per-unit 1", "--metres-per-unit is of the model"),
        ("import . --name yours --model m --metres-per-unit 0", "metres_per_unit is 0"),
        ("import . --name yours --height-m 0", "height_m is 0"),
    ],
)
def test_mistakes(gatetune, arguments: str, words: str) -> None:
    write_part_of_a_set()
    assert words in gatetune.refused("photographs", *arguments.split())


def test_what_is_set_of_missions_over_a_set_is_flown_and_recorded(gatetune, monkeypatch) -> None:
    write_part_of_a_set()  # of too few photographs: missions fail at once
    asked = ("--rock", "mine", "--set", "dense.agreeing_views=6")
    gatetune("mission", "run", *asked, "--out", "m")
    for name in ("config.yaml", "located.yaml"):
        config = read_yaml(Path("m", name))
        assert (config["preset"], config["dense"]["agreeing_views"]) == ("photographs", 6)
        assert config["dense"]["max_size_px"] == 480
    seen: list[CampaignSettings] = []
    monkeypatch.setattr("tuner.commands.campaign.require_comparable", seen.append)
    gatetune("campaign", "run", *asked, "--scheduler", "nowhere")
    assert (seen[0].preset, seen[0].problem.base.dense.agreeing_views) == ("photographs", 6)
