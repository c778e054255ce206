"""A route as QGroundControl reads it."""

import itertools
import math

import numpy as np
import pytest

from nbv.config import preset
from nbv.errors import UserError
from nbv.flight.route import clear
from nbv.viewpoints import raw_candidates, seed_viewpoints
from tuner.bridges import Home, qgc_plan

HOME = Home(33.42, -111.93, 360.0)
CONFIG = preset("campaign")
SEEDS = [view.id for view in seed_viewpoints(CONFIG)]


def places(plan, commands=(16,)):
    return [item["params"][4:] for item in plan["mission"]["items"] if item["command"] in commands]


def metres(place):
    """(3,) east, north, up of home on the sphere that touches the ellipsoid there; good to 1 mm in 10 m."""
    return np.array(
        [
            math.radians(place[1] - HOME.longitude_deg) * 6384e3 * math.cos(math.radians(HOME.latitude_deg)),
            math.radians(place[0] - HOME.latitude_deg) * 6355e3,
            place[2],
        ]
    )


def test_every_view_is_flown_in_order_and_photographed_once():
    views = [*SEEDS, "cand_005", "cand_140"]
    plan = qgc_plan(CONFIG, views, HOME)
    commands = [item["command"] for item in plan["mission"]["items"]]
    assert commands[0] == 22 and commands[-1] == 20 and commands.count(2000) == len(views)
    assert [item["doJumpId"] for item in plan["mission"]["items"]] == list(range(1, len(commands) + 1))
    known = {view.id: view for view in (*seed_viewpoints(CONFIG), *raw_candidates(CONFIG))}
    settled = [i["params"] for i in plan["mission"]["items"] if i["command"] == 16 and i["params"][0] > 0]
    for name, params in zip(views, settled, strict=True):
        where = np.array(known[name].position_m) - np.array(CONFIG.flight.home_m)
        assert np.allclose(metres(params[4:]), where, atol=0.02), name


def test_no_leg_passes_through_the_target():
    views = ["seed_00", "seed_04"]  # opposite sides of the lowest ring
    plan = qgc_plan(CONFIG, views, HOME)
    points = [metres(place) + np.array(CONFIG.flight.home_m) for place in places(plan, (16, 22))]
    assert len(points) > 1 + len(views)
    for a, b in itertools.pairwise(points):
        assert clear(a, b, np.array(CONFIG.target_m), CONFIG.flight.keep_out_radius_m - 0.02, 2.2)


@pytest.mark.parametrize("place", [(91.0, 0.0), (0.0, 200.0), (math.nan, 0.0)])
def test_a_home_that_is_no_place_is_refused(place):
    with pytest.raises(UserError, match="no place"):
        Home(*place)
