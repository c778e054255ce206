"""The picture of a plan, every photograph once from above and once from the side, and labels that tell apart."""

from __future__ import annotations

import math

import pytest

from nbv.config import preset
from tuner.report.answer import plan_words
from tuner.report.figures import plan_figure

ORBIT = {
    "seed.count": 25,
    "seed.lowest_deg": 10.0,
    "seed.span_deg": 25.0,
    "seed.upper_share": 0.36,
    "seed.radius_m": 3.5,
    "stop.adaptive_budget": 0,
}


def test_an_orbit_is_drawn_and_said() -> None:
    config = preset("campaign").with_values(ORBIT)
    assert plan_words(config) == "16 photographs at 10° and 9 at 35°"
    above, beside = plan_figure(config).axes
    pool, seeds = above.lines
    east, north = seeds.get_data()
    assert len(east) == 25 and not len(pool.get_xdata())
    assert len({round(up, 3) for up in beside.lines[1].get_ydata()}) == 2  # two rings, two heights
    lower, upper = math.hypot(east[0], north[0]), math.hypot(east[-1], north[-1])
    assert upper / lower == pytest.approx(math.cos(math.radians(35)) / math.cos(math.radians(10)), abs=0.01)
    assert (
        len(plan_figure(preset("campaign")).axes[0].lines[0].get_xdata()) > 50
    )  # where planned views may be
