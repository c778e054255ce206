"""The authors' files, every key there and back, and what cannot be said; a route as QGroundControl reads it; the command."""

import csv
import functools
import itertools
import json
import math

import fake_campaigns
import numpy as np
import pytest
import yaml

from nbv.config import MissionConfig, config_from_dict, preset
from nbv.errors import UserError
from nbv.geometric import run_geometric_mission
from nbv.viewpoints import raw_candidates, seed_viewpoints
from tuner.export.photogrammetry_nbv import (
    BASELINE_AWARE,
    FILES,
    HYBRID,
    MISSION,
    PARAMETERS,
    SCORING,
    published,
    write_mission,
    write_scoring,
    write_text,
)
from tuner.export.route import Home, qgc_plan
from tuner.export.table import write_rows
from tuner.problem.baselines import label, scorer_alone
from tuner.problem.observations import short
from tuner.problem.space_files import load_search_space

# Their rock stands 8 m east of the take-off point; our world is turned, so that it lies north of it there.
PAPER_CODE = preset("paper-code").with_values({"flight.home_m": [-8.0, 0.0, 0.0]})
WRITERS = {"scoring.yaml": write_scoring, "unified_mission.yaml": write_mission}
DIRECT = [
    (kind, key, parameter, published(kind)[key])
    for kind, parameters in (("scoring.yaml", SCORING), ("unified_mission.yaml", MISSION))
    for key, parameter in parameters.items()
]


CHANGED = [
    *(
        (kind, {parameter: 1.5 * usual}, {key: pytest.approx(1.5 * usual)})
        for kind, key, parameter, usual in DIRECT
        if isinstance(usual, float) and usual
    ),
    *(
        (kind, {parameter: usual[:-1]}, {key: usual[:-1]})
        for kind, key, parameter, usual in DIRECT
        if isinstance(usual, list) and not key.startswith("seed_")
    ),
    *(
        (kind, {parameter: usual + 1}, {key: usual + 1})
        for kind, key, parameter, usual in DIRECT
        if isinstance(usual, int)
    ),
    ("scoring.yaml", {"gate.oracle_quality_weight": 0.5}, {"hybrid.oracle.quality_credit_weight": 0.5}),
    ("scoring.yaml", {"gate.kind": "hyb-o"}, {"name": HYBRID, "hybrid.gate_mode": "oracle"}),
    ("scoring.yaml", {"gate.kind": "covis"}, {"name": "covisibility"}),
    ("scoring.yaml", {"gate.kind": "b-aware"}, {"name": BASELINE_AWARE}),
    ("scoring.yaml", {"b_aware.weights.main": 2.5}, {"weights.geometry_aware_repair": 2.5}),
    (  # the others are shared there: only ratios matter
        "scoring.yaml",
        {"b_aware.weights.nov": 0.6, "b_aware.weights.move": 0.05, "b_aware.weights.ang": 0.2},
        {"weights.novelty": 1.2, "weights.geometry_aware_repair": 2.0},
    ),
    ("scoring.yaml", {"b_aware.density_neighbours": 8}, {f"{BASELINE_AWARE}.density_k": 8}),
    (
        "unified_mission.yaml",
        {"seeds": 16, "seed.ring_elevations_deg": [20.0, 30.0], "seed.ring_azimuth_counts": [10, 6]},
        {
            "seed_elevation_rings_deg": [20.0, 30.0],
            "seed_azimuth_counts": [10, 6],
            "ring_image_count": 16,
        },
    ),
    (  # north, east and down from the take-off point
        "unified_mission.yaml",
        {"target_m": [0.0, 0.0, 0.5], "flight.home_m": [-6.0, -2.0, 0.0]},
        {"rock_center_x": 2.0, "rock_center_y": 6.0, "rock_center_z": -0.5},
    ),
    (
        "unified_mission.yaml",
        {"pool.min_altitude_m": 1.3, "pool.max_altitude_m": 1.6},
        {"min_altitude_ned": -1.6, "max_altitude_ned": -1.3},
    ),
    ("unified_mission.yaml", {"flight.arrival_tolerance_m": 0.2}, {"position_tolerance_z": 0.2}),
    ("unified_mission.yaml", {"photographs": 84}, {"image_budget": 60, "max_image_budget": 60}),
]
A_TURN = {
    "seed.layout",
    "seed.lowest_deg",
    "seed.span_deg",
    "seed.upper_share",
}  # written as rings, see below


@pytest.mark.parametrize("kind", FILES)
def test_preset_paper_code_is_the_published_files(kind):
    written, _ = WRITERS[kind](PAPER_CODE)
    # Optional there; and read only where the block above them is missing.
    left_out = ("weights.geometry_aware_repair", f"{BASELINE_AWARE}.weakness_weights")
    same = {path: value for path, value in written.items() if not path.startswith(left_out)}
    known = published(kind)
    assert same == {path: known[path] for path in same} and len(written) > 30
    assert len(DIRECT) == 36
    assert set(PARAMETERS[kind]) - A_TURN <= {
        path for k, changes, _ in CHANGED if k == kind for path in changes
    }


@pytest.mark.parametrize(("kind", "changes", "expected"), CHANGED, ids=str)
def test_a_changed_parameter_is_a_changed_key(kind, changes, expected):
    written, _ = WRITERS[kind](PAPER_CODE.with_values(changes))
    tree = yaml.safe_load(write_text(written, kind))
    for part in FILES[kind]:
        tree = tree[part]
    for path, value in expected.items():
        assert functools.reduce(lambda node, part: node[part], path.split("."), tree) == value
    assert all(path in PARAMETERS[kind] for path in changes)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("b_aware.weights.nov", 0.1),
        ("shared.d_scale_m", 0.4),
        ("stop.knn_region", "box"),
        ("gate.geometry_scorer", "predicted"),
    ],
)
def test_what_cannot_be_said_there_is_reported(key, value):
    _, remarks = write_scoring(preset("paper").with_values({key: value}))
    assert key in {remark.key for remark in remarks}
    with pytest.raises(UserError, match="greedy-oracle"):  # a gate that only flies here
        write_scoring(preset("paper").with_values({key: value, "gate.kind": "greedy-oracle"}))


@pytest.mark.parametrize(
    ("write", "change", "key"),
    [
        (write_scoring, {"gate.kind": "hyb-h", "gate.d95_m": 0.6}, "hybrid.heuristic.knn_p95_threshold"),
        (write_mission, {"stop.knn_threshold_m": 0.2, "stop.criterion": "both"}, "knn_distance_threshold"),
    ],
)
def test_a_distance_in_unknown_units_is_never_written(write, change, key):
    """Their code would read our metres as COLMAP's units; a criterion that needs the distance stays as published, too."""
    values, remarks = write(MissionConfig().with_values(change))
    assert values[key] == {**published("scoring.yaml"), **published("unified_mission.yaml")}[key]
    said = {remark.key: remark.text for remark in remarks}
    assert change.keys() - {"gate.kind"} <= said.keys()
    assert any(f"{key} stays {values[key]:g}" in text for text in said.values())
    assert values.get("stopping_criterion", "image_budget") == "image_budget"


@pytest.mark.parametrize(
    ("seeds", "elevations_deg", "counts"),
    [
        ({"seed.upper_share": 0.3, "seed.span_deg": 21.0}, [20.0, 41.0], [9, 4]),
        ({"seed.lowest_deg": 25.0}, [25.0], [13]),
        ({"seed.layout": "rings"}, [15.0, 22.0, 29.0, 36.0], [4, 4, 3, 2]),
    ],
)
def test_fewer_seeds_are_written_as_the_rings_that_they_are(seeds, elevations_deg, counts) -> None:
    few = {"photographs": 18, "seeds": 13, "sparse.ground_features": 2000, "seed.layout": "turn", **seeds}
    written, remarks = write_mission(preset("campaign").with_values(few))
    assert written["seed_elevation_rings_deg"] == elevations_deg
    assert written["seed_azimuth_counts"] == counts and written["ring_image_count"] == 13
    assert written["image_budget"] == 5  # and 13 seeds make 18
    assert "sparse.ground_features" in {remark.key for remark in remarks}


HOME = Home(33.42, -111.93, 360.0)
CONFIG = preset("campaign")
SEEDS = [view.id for view in seed_viewpoints(CONFIG)]


def metres(place):
    """(3,) east, north, up of home on the sphere that touches the ellipsoid there; good to 1 mm in 10 m."""
    latitude_deg, longitude_deg, up_m = place
    across_m = 6384e3 * math.cos(math.radians(HOME.latitude_deg))
    east_m = math.radians(longitude_deg - HOME.longitude_deg) * across_m
    return np.array([east_m, math.radians(latitude_deg - HOME.latitude_deg) * 6355e3, up_m])


def way_of(plan, home_m):
    """(N, 3) places on the way that a plan flies, and its corners."""
    items = [item for item in plan["mission"]["items"] if item["command"] in (16, 22)]
    points = np.array([metres(item["params"][4:]) for item in items]) + home_m
    return np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(points)]), points


def test_every_view_is_flown_in_order_and_photographed_once():
    views = [*SEEDS, "cand_005", "cand_140"]
    plan = qgc_plan(CONFIG, views, HOME)
    commands = [item["command"] for item in plan["mission"]["items"]]
    assert commands[0] == 22 and commands[-1] == 20 and commands.count(2000) == len(views)
    assert [item["doJumpId"] for item in plan["mission"]["items"]] == list(range(1, len(commands) + 1))
    known = {view.id: view for view in (*seed_viewpoints(CONFIG), *raw_candidates(CONFIG))}
    speed = plan["mission"]["items"][commands.index(178)]
    assert commands.index(178) < commands.index(16) and commands.count(178) == 1
    assert speed["params"][:3] == [1, CONFIG.flight.max_speed_m_s, -1]  # of the ground; the throttle as it is
    settled = [i["params"] for i in plan["mission"]["items"] if i["command"] == 16 and i["params"][0] > 0]
    for name, params in zip(views, settled, strict=True):
        where = np.array(known[name].position_m) - np.array(CONFIG.flight.home_m)
        assert np.allclose(metres(params[4:]), where, atol=0.02), name


def test_the_gimbal_is_aimed_at_the_target_before_the_hover_that_waits_for_it():
    config = CONFIG.with_values({"flight.home_m": [0.0, 8.0, 0.0]})
    items = qgc_plan(config, [*SEEDS, "cand_140"], HOME)["mission"]["items"]
    photographs = [k for k, item in enumerate(items) if item["command"] == 2000]
    for k in photographs:
        gimbal, hover = items[k - 2], items[k - 1]
        assert (gimbal["command"], hover["command"]) == (1000, 16) and hover["params"][0] > 0
        place = metres(hover["params"][4:]) + config.flight.home_m
        east_m, north_m, up_m = np.array(config.target_m) - place
        pitch_deg = math.degrees(math.atan2(up_m, math.hypot(east_m, north_m)))
        assert gimbal["params"][0] == pytest.approx(pitch_deg, abs=0.5) and pitch_deg < 0


@pytest.mark.parametrize("home_m", [(0.0, 8.0, 0.0), (0.0, -8.0, 0.0), (5.0, -2.0, 0.0)])
@pytest.mark.parametrize("last", ["seed_00", "seed_06", "cand_140"])
def test_the_way_there_and_back_keeps_out_of_the_target(home_m, last):
    config = CONFIG.with_values({"flight.home_m": list(home_m)})
    way, points = way_of(qgc_plan(config, ["seed_12", last], HOME), home_m)
    low = way[way[:, 2] < config.flight.keep_out_height_m - 0.03]
    assert np.hypot(low[:, 0], low[:, 1]).min(initial=9.0) >= config.flight.keep_out_radius_m - 0.03
    above_home = np.add(home_m, (0, 0, config.flight.takeoff_altitude_m))
    assert np.allclose(points[[0, -1]], above_home, atol=0.02)  # the last command has nowhere to go but down


@pytest.mark.parametrize("longitude_deg, east_m", [(179.99999, 5.0), (-179.99999, -5.0), (180.0, 0.0)])
def test_a_route_across_180_degrees_stays_within_them(longitude_deg, east_m):
    there = Home(-17.0, longitude_deg).place(east_m, 0.0)[1]
    assert -180 <= there <= 180
    assert (there - longitude_deg + 180) % 360 - 180 == pytest.approx(east_m / 106460, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"gate.budget_fraction": 0.0, "gate.d95_m": 1.0}, "covis"),
        ({"gate.budget_fraction": 1.0, "gate.d95_m": 0.2}, "b-aware"),
        ({"gate.budget_fraction": 0.0, "gate.d95_m": 0.2}, ""),
        ({"gate.budget_fraction": 0.1, "gate.d95_m": 1.0}, ""),
        ({"gate.budget_fraction": 0.0, "gate.d95_m": 1.0, "gate.kind": "hyb-o"}, ""),
    ],
)
def test_a_gate_that_cannot_switch_is_named_as_the_scorer_that_it_is(values, says):
    assert scorer_alone(CONFIG.with_values(values)) == says


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "c"
    return fake_campaigns.run(directory, space=load_search_space("upstream"))


def test_every_export_says_the_same(gatetune, campaign, tmp_path):
    best = campaign.recommendation(save=False)
    name = campaign.settings.problem.answers[-1].name
    wanted = campaign.recommended_config(name)
    trees = {}
    for kind in ("gatetune.yaml", "scoring.yaml", "unified_mission.yaml"):
        asked = ("export", campaign.directory, "--strategy", name, "--to", kind)
        trees[kind] = json.loads(gatetune.ok(*asked, "--json", "--out", tmp_path / kind))
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
    asked = ("export", campaign.directory, "--strategy", "orbit", "--to", "gatetune.yaml")
    said = gatetune.ok(*asked, "--out", out)
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
        (("--to", "plan", "--home", "91,0"), "not on the map"),
        (("--strategy", "orbitt", "--to", "gatetune.yaml"), "did you mean"),
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
