import json
from pathlib import Path

import pytest
from photographed_ball import write_part_of_a_set


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
