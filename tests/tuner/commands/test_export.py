"""The recommendation as files for the vehicle."""

import dataclasses
import html
import json
from operator import attrgetter

import fake_campaigns
import pytest
import yaml
from authors_files import read_mission, read_scoring

from nbv.config import MissionConfig, config_from_dict
from tuner.campaign.campaign import Campaign
from tuner.export.photogrammetry_nbv import read_file
from tuner.export.vehicle_files import change_text
from tuner.problem.space_files import load_search_space
from tuner.report.answer import use_sentence, value_text
from tuner.report.campaign_page import write_campaign_report


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "c"
    return fake_campaigns.run(directory, space=load_search_space("upstream"))


@pytest.fixture
def recommends(monkeypatch, campaign, tmp_path):
    """Let a campaign in a named space recommend ``changes`` of its default; returns its directory."""

    def make(space, changes):
        found = fake_campaigns.run(
            tmp_path / "tune", space=load_search_space(space), budget=3, sampler="sobol"
        )
        best, default = campaign.recommendation(save=False), found.settings.problem.default
        fixed = dataclasses.replace(
            best, values={**default, **changes}, default_values=default, improvement=6.0
        )
        monkeypatch.setattr(Campaign, "recommendation", lambda self, *, save=True: fixed)
        return found.directory

    return make


FEWER = {"seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.45}


def test_photographs_go_into_the_file_that_carries_them(gatetune, recommends):
    run = recommends("photographs", FEWER)
    code, _, err = gatetune("export", run, "--to", "scoring.yaml")
    assert code == 2 and err.count("\n") == 1
    assert "carries none of the changes" in err and f"gatetune export {run} --to unified_mission.yaml" in err
    assert not (run / "scoring.yaml").exists()
    code, out, err = gatetune("export", run, "--to", "unified_mission.yaml")
    assert code == 0 and "it carries 3 of 3 changes" in out, err
    written = read_file(run / "unified_mission.yaml", "unified_mission.yaml")
    assert (sum(written["seed_azimuth_counts"]), written["image_budget"]) == (14, 12)
    assert written["min_altitude_ned"] == -1.45
    text = (run / "unified_mission.yaml").read_text()
    assert "# carries: seed.count 14 (default 24)" in text and "+6" in text, text


def test_status_page_and_every_export_say_the_same(gatetune, campaign, tmp_path):
    values = json.loads(gatetune("campaign", "status", campaign.directory, "--json")[1])["recommendation"][
        "values"
    ]
    assert values == campaign.recommendation(save=False).values != campaign.settings.problem.default
    wanted = campaign.settings.problem.config(values)
    trees = {}
    for kind in ("gatetune.yaml", "scoring.yaml", "unified_mission.yaml"):
        code, out, _ = gatetune(
            "export", campaign.directory, "--to", kind, "--json", "--out", tmp_path / kind
        )
        trees[kind] = json.loads(out)
        assert code == 0 and trees[kind]["wrote"] == str(tmp_path / kind)
    assert config_from_dict(yaml.safe_load((tmp_path / "gatetune.yaml").read_text())) == wanted
    readers = {"scoring.yaml": read_scoring, "unified_mission.yaml": read_mission}
    for kind, read in readers.items():
        there = MissionConfig().with_values(read(read_file(tmp_path / kind, kind)))
        for path in trees[kind]["carried"]:
            assert attrgetter(path)(there) == pytest.approx(attrgetter(path)(wanted))
    listed = json.loads(gatetune("export", campaign.directory, "--json")[1])
    assert listed["values"] == values
    assert {f["name"]: f["carried"] for f in listed["files"]} == {k: t["carried"] for k, t in trees.items()}
    best = campaign.recommendation(save=False)
    page = html.unescape(write_campaign_report(campaign).read_text())
    assert use_sentence(best, campaign.settings) in gatetune("campaign", "status", campaign.directory)[1]
    assert use_sentence(best, campaign.settings) in page.replace("\u00a0", " ")
    assert all(path in page and value_text(values, path) in page for path in best.changed)
    assert (
        f"recommended: {', '.join(change_text(best, path) for path in best.changed)}"
        in gatetune("export", campaign.directory)[1]
    )


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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "plan"), "plan needs it"),
        (("--to", "plan", "--home", "north"), "LATITUDE,LONGITUDE"),
        (("--to", "plan", "--home", "1,2"), "its missions are of a mission file"),
        (("--to", "scoring.yaml", "--onto", "none.yaml"), "is not a file"),
        (("--to", "scoring.yaml", "--out", "no/where.yaml"), "is not a folder"),
    ],
)
def test_a_mistake_is_one_line(gatetune, campaign, arguments, says):
    code, _, err = gatetune("export", campaign.directory, *arguments)
    assert code == 2 and says in err and len(err.strip().splitlines()) == 1
