import math

import pytest

from nbv.config import preset
from tuner.report.answer import plan_words
from tuner.report.figures import plan_figure


def test_an_orbit_is_drawn_and_said() -> None:
    seeds = {
        "count": 25,
        "rings": 1,
        "lowest_deg": 10.0,
        "span_deg": 25.0,
        "upper_share": 0.36,
        "radius_m": 3.5,
    }
    orbit = {"stop.adaptive_budget": 0, **{f"seed.{name}": value for name, value in seeds.items()}}
    config = preset("campaign").with_values(orbit)
    assert plan_words(config) == "16 photographs at 10° and 9 at 35°"
    above, beside = plan_figure(config).axes
    pool, seeds_drawn = above.lines
    east, north = seeds_drawn.get_data()
    assert len(east) == 25 and not len(pool.get_xdata())
    assert len({round(up, 3) for up in beside.lines[1].get_ydata()}) == 2  # two rings, two heights
    lower, upper = math.hypot(east[0], north[0]), math.hypot(east[-1], north[-1])
    assert upper / lower == pytest.approx(math.cos(math.radians(35)) / math.cos(math.radians(10)), abs=0.01)
    assert (
        len(plan_figure(preset("campaign")).axes[0].lines[0].get_xdata()) > 50
    )  # where planned views may be
