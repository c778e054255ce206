import csv
import dataclasses
import html
import json

import fake_campaigns
import pytest
import yaml
from tuner.report.answer import use_sentence, value_text

from nbv.config import config_from_dict, preset
from nbv.geometric import run_geometric_mission
from tuner.campaign.campaign import Campaign
from tuner.export.photogrammetry_nbv import write_mission, write_scoring, write_text
from tuner.export.table import write_rows
from tuner.problem.observations import short
from tuner.problem.space_files import load_search_space
from tuner.report.campaign_page import write_campaign_report


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "c"
    return fake_campaigns.run(directory, space=load_search_space("upstream"))


def test_photographs_go_into_the_file_that_carries_them(gatetune, monkeypatch, campaign, tmp_path):
    """Of a campaign that recommends fewer photographs than its default has."""
    space = load_search_space("photographs")
    found = fake_campaigns.run(tmp_path / "tune", space=space, budget=3, sampler="sobol")
    run, default = found.directory, found.settings.problem.default
    fewer = {**default, "seed.count": 14, "stop.adaptive_budget": 12, "pool.max_altitude_m": 1.45}
    best = campaign.recommendation(save=False)
    fixed = dataclasses.replace(best, values=fewer, default_values=default, improvement=6.0)
    monkeypatch.setattr(Campaign, "recommendation", lambda self, *, save=True: fixed)
    said = gatetune.ok("export", run)
    assert "scoring.yaml carries 0 of 3 changes" in said
    assert f"gatetune export {run} --to unified_mission.yaml" in said
    assert "it carries 3 of 3 changes" in gatetune.ok("export", run, "--to", "unified_mission.yaml")
    written = yaml.safe_load((run / "unified_mission.yaml").read_text())["/**"]["ros__parameters"]
    assert (sum(written["seed_azimuth_counts"]), written["image_budget"]) == (14, 12)
    assert written["min_altitude_ned"] == -1.45
    text = (run / "unified_mission.yaml").read_text()
    assert "# carries: seed.count 14 (default 24)" in text and "+6" in text, text


def test_status_page_and_every_export_say_the_same(gatetune, campaign, tmp_path):
    best = campaign.recommendation(save=False)
    status = gatetune.ok("campaign", "status", campaign.directory, "--json")
    values = json.loads(status)["recommendation"]["values"]
    assert values == best.values != campaign.settings.problem.default
    wanted = campaign.settings.problem.config(values)
    trees = {}
    for kind in ("gatetune.yaml", "scoring.yaml", "unified_mission.yaml"):
        asked = ("export", campaign.directory, "--to", kind, "--json", "--out", tmp_path / kind)
        trees[kind] = json.loads(gatetune.ok(*asked))
        assert trees[kind]["wrote"] == str(tmp_path / kind)
    assert config_from_dict(yaml.safe_load((tmp_path / "gatetune.yaml").read_text())) == wanted
    for kind, write in {"scoring.yaml": write_scoring, "unified_mission.yaml": write_mission}.items():
        text = (tmp_path / kind).read_text()
        assert yaml.safe_load(text) == yaml.safe_load(write_text(write(wanted)[0], kind))
    listed = json.loads(gatetune.ok("export", campaign.directory, "--json"))
    assert {path: listed["values"][path] for path in best.changed} == {
        path: values[path] for path in best.changed
    }
    assert {f["name"]: f["carried"] for f in listed["files"]} == {k: t["carried"] for k, t in trees.items()}
    page = html.unescape(write_campaign_report(campaign).read_text())
    for text in (gatetune.ok("campaign", "status", campaign.directory), page.replace("\u00a0", " ")):
        assert use_sentence(best, campaign.settings) in text
    exported = gatetune.ok("export", campaign.directory)
    assert all(path in page and value_text(values, path) in page for path in best.changed)
    assert all(f"{path} {short(values[path])} (default " in exported for path in best.changed)


def test_a_route_repeats_views_flown_again_but_no_unfinished_mission(gatetune, tmp_path):
    run, seeds = tmp_path / "mission", {"seed.count": 16, "seed.lowest_deg": 20.0}
    again = {"gate.kind": "movement-only", "pool.revisit_exclusion_m": 0.0, "stop.adaptive_budget": 2}
    run_geometric_mission(preset("campaign").with_values({**seeds, **again}), "slab", 0, run)
    asked = ("export", run, "--to", "plan", "--home", "1,2")
    assert "18 photographs (16 seeds, then 2 planned" in gatetune.ok(*asked)
    items = json.loads((run / "route.plan").read_text())["mission"]["items"]
    places = [item["params"][4:] for item in items if item["command"] == 16 and item["params"][0] > 0]
    assert len(places) == 18 and places[16] == places[17]
    (run / "mission.json").unlink()
    assert "holds no mission.json; name the directory of a finished mission" in gatetune.refused(*asked)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "plan"), "plan needs it"),
        (("--to", "plan", "--home", "north"), "LATITUDE,LONGITUDE"),
        (("--to", "plan", "--home", "1,2,nan"), "the altitude of home is nan"),
        (("--to", "scoring.yaml", "--out", "no/where.yaml"), "is not a folder"),
    ],
)
def test_a_mistake_is_one_line(gatetune, campaign, arguments, says):
    assert says in gatetune.refused("export", campaign.directory, *arguments)


def test_names_are_no_formulas_for_a_spreadsheet(gatetune, tmp_path):
    run = fake_campaigns.run(tmp_path / "run", sampler="sobol", budget=2, rocks=("=1+1", "b")).directory
    gatetune.ok("export", run, "--to", "csv")
    with (run / "missions.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["rock"] for row in rows] == ["'=1+1", "b"]
    table = write_rows(tmp_path / "t.csv", ("@name", "n"), [("-x", -1.5), ("+1", 2), ("a=b", -3)])
    assert table.read_text() == "'@name,n\n'-x,-1.5\n'+1,2\na=b,-3\n"
