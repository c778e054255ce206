import csv
import dataclasses
import json

import fake_campaigns
import pytest
import yaml

from nbv.config import config_from_dict, preset
from nbv.geometric import run_geometric_mission
from tuner.export.photogrammetry_nbv import write_mission, write_scoring, write_text
from tuner.export.table import write_rows
from tuner.export.vehicle_files import Exported, vehicle_files
from tuner.problem.baselines import TUNED_PLANNER, label
from tuner.problem.observations import short
from tuner.problem.space_files import load_search_space


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "c"
    return fake_campaigns.run(directory, space=load_search_space("upstream"))


def test_a_header_says_what_a_file_carries_and_what_that_was_worth(tmp_path):
    """Of a campaign that recommends fewer photographs than its default has."""
    run = fake_campaigns.run(
        tmp_path / "tune", space=load_search_space("photographs"), budget=3, sampler="sobol"
    )
    problem, best = run.settings.problem, run.recommendation(save=False)
    fewer = {**problem.default, "photographs": 26, "seeds": 14, "pool.max_altitude_m": 1.45}
    worth = dataclasses.replace(best, values=fewer, default_values=problem.default, improvement=6.0)
    scoring, mission, ours = vehicle_files(Exported(run, TUNED_PLANNER, problem.config(fewer), worth))
    assert (scoring.share, mission.share, ours.share) == (
        "0 of 3 changes, not photographs, seeds, pool.max_altitude_m",
        "3 of 3 changes",
        "3 of 3 changes",
    )
    written = yaml.safe_load(mission.text)["/**"]["ros__parameters"]
    assert (sum(written["seed_azimuth_counts"]), written["image_budget"]) == (14, 12)
    assert written["min_altitude_ned"] == -1.45
    assert "# carries: seeds 14 (default 24)" in mission.text and "+6" in mission.text
    assert "# does not carry: seeds 14 (default 24)" in scoring.text


def test_every_export_says_the_same(gatetune, campaign, tmp_path):
    best = campaign.recommendation(save=False)
    name = campaign.settings.problem.answers[-1].name
    wanted = campaign.recommended_config(name)
    trees = {}
    for kind in ("gatetune.yaml", "scoring.yaml", "unified_mission.yaml"):
        asked = (
            "export",
            campaign.directory,
            "--strategy",
            name,
            "--to",
            kind,
            "--json",
            "--out",
            tmp_path / kind,
        )
        trees[kind] = json.loads(gatetune.ok(*asked))
        assert trees[kind]["wrote"] == str(tmp_path / kind)
    assert config_from_dict(yaml.safe_load((tmp_path / "gatetune.yaml").read_text())) == wanted
    for kind, write in {"scoring.yaml": write_scoring, "unified_mission.yaml": write_mission}.items():
        text = (tmp_path / kind).read_text()
        assert yaml.safe_load(text) == yaml.safe_load(write_text(write(wanted)[0], kind))
    listed = json.loads(gatetune.ok("export", campaign.directory, "--strategy", name, "--json"))
    assert {path: listed["values"][path] for path in best.changed} == {
        path: best.values[path] for path in best.changed
    }
    assert {f["name"]: f["carried"] for f in listed["files"]} == {k: t["carried"] for k, t in trees.items()}
    exported = gatetune.ok("export", campaign.directory, "--strategy", name)
    assert all(f"{path} {short(best.values[path])} (default " in exported for path in best.changed)


def test_a_strategy_that_is_named_is_what_is_said_and_written(gatetune, campaign, tmp_path):
    """And no other one's advice stands above it."""
    out = tmp_path / "orbit.yaml"
    said = gatetune.ok(
        "export", campaign.directory, "--strategy", "orbit", "--to", "gatetune.yaml", "--out", out
    )
    config = config_from_dict(yaml.safe_load(out.read_text()))
    assert (config.seed.lowest_deg, config.planned_views) == (10.0, 0)
    assert f"{label('orbit')}: " in said and "Fly " not in said
    assert f"seeds {config.seeds} (default {campaign.settings.problem.base.seeds})" in said


def test_a_route_repeats_views_flown_again_but_no_unfinished_mission(gatetune, tmp_path):
    run, seeds = tmp_path / "mission", {"seeds": 16, "seed.layout": "turn", "seed.lowest_deg": 20.0}
    again = {"gate.kind": "movement-only", "pool.revisit_exclusion_m": 0.0, "photographs": 18}
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
