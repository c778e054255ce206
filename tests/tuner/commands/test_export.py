"""The recommendation as files for the vehicle."""

import json

import fake_campaigns
import pytest
import yaml

from adapters.photogrammetry_nbv import read_file, read_mission, read_scoring
from nbv.config import MissionConfig, config_from_dict, preset
from nbv.geometric import run_geometric_mission
from tuner.problem.space_files import load_search_space


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "c"
    return fake_campaigns.run(directory, space=load_search_space("upstream"))


def test_the_authors_files_say_what_was_recommended(gatetune, campaign):
    for kind in ("scoring.yaml", "unified_mission.yaml"):
        code, out, err = gatetune("export", campaign.directory, "--to", kind)
        assert code == 0, err
        assert f"wrote {campaign.directory / kind}" in out
    there = {
        **read_scoring(read_file(campaign.directory / "scoring.yaml", "scoring.yaml"))[0],
        **read_mission(read_file(campaign.directory / "unified_mission.yaml", "unified_mission.yaml"))[0],
    }
    wanted, back = campaign.recommended_config(), MissionConfig().with_values(there)
    assert (back.covis, back.b_aware, back.pool) == (wanted.covis, wanted.b_aware, wanted.pool)
    head = (campaign.directory / "scoring.yaml").read_text().splitlines()[:4]
    assert "campaign test" in head[1] and "95 %" in head[2] and "does not transfer" in head[3]


def test_ours_is_the_whole_configuration(gatetune, campaign, tmp_path):
    code, _, err = gatetune(
        "export", campaign.directory, "--to", "gatetune.yaml", "--out", tmp_path / "g.yaml"
    )
    assert code == 0, err
    tree = yaml.safe_load((tmp_path / "g.yaml").read_text())
    assert config_from_dict(tree).digest() == campaign.recommended_config().digest()


def test_other_keys_of_their_file_are_kept(gatetune, campaign, tmp_path):
    (tmp_path / "mine.yaml").write_text("scorer: {gimbal_pitch_rad: -0.3, hybrid: {shadow: {log_top_k: 9}}}")
    code, _, err = gatetune(
        "export",
        campaign.directory,
        "--to",
        "scoring.yaml",
        "--onto",
        tmp_path / "mine.yaml",
        "--out",
        "s.yaml",
    )
    assert code == 0, err
    written = read_file(tmp_path / "s.yaml", "scoring.yaml")
    assert (written["gimbal_pitch_rad"], written["hybrid.shadow.log_top_k"]) == (-0.3, 9)


def test_a_mission_becomes_a_route(gatetune, tmp_path):
    config = preset("campaign").with_values({"stop.adaptive_budget": 2})
    run_geometric_mission(config, "slab", 0, tmp_path / "m")
    code, out, err = gatetune("export", tmp_path / "m", "--to", "plan", "--home", "33.4,-111.9")
    assert code == 0, err
    assert "a fixed route" in out
    items = json.loads((tmp_path / "m" / "route.plan").read_text())["mission"]["items"]
    assert sum(item["command"] == 2000 for item in items) == 26


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "plan"), "plan needs it"),
        (("--to", "plan", "--home", "north"), "LATITUDE,LONGITUDE"),
        (("--to", "plan", "--home", "1,2"), "no mission with its flight"),
        (("--to", "scoring.yaml", "--onto", "none.yaml"), "is not a file"),
        (("--to", "scoring.yaml", "--out", "no/where.yaml"), "is no folder"),
    ],
)
def test_a_mistake_is_one_line(gatetune, campaign, arguments, says):
    code, _, err = gatetune("export", campaign.directory, *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
