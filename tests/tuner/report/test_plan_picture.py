"""The picture of a plan, every photograph once from above and once from the side, and labels that tell apart."""

from __future__ import annotations

import math
from xml.etree import ElementTree

import pytest

from nbv.config import preset
from tuner.report.answer import plan_words
from tuner.report.plan_picture import plan_picture

ORBIT = {
    "seed.count": 25,
    "seed.rings": 1,
    "seed.lowest_deg": 10.0,
    "seed.span_deg": 25.0,
    "seed.upper_share": 0.36,
    "seed.radius_m": 3.5,
    "stop.adaptive_budget": 0,
}


def circles(text: str, fill: str) -> list[tuple[float, float]]:
    found = ElementTree.fromstring(text).findall("circle")
    return [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in found if c.attrib["fill"] == fill]


def test_an_orbit_is_drawn_and_said() -> None:
    config = preset("campaign").with_values(ORBIT)
    assert plan_words(config, ceiling=True) == "16 photographs at 10° and 9 at 35°"
    blue = circles(plan_picture(config), "#0072B2")
    assert len(blue) == 2 * 25 and not circles(plan_picture(config), "#b8b8b8")
    above, beside = blue[::2], blue[1::2]
    assert len({round(y, 1) for _, y in beside}) == 2  # two rings, two heights
    (x, y), *_ = circles(plan_picture(config), "#c9a98b")
    lower, upper = math.dist(above[0], (x, y)), math.dist(above[-1], (x, y))
    assert upper / lower == pytest.approx(math.cos(math.radians(35)) / math.cos(math.radians(10)), abs=0.01)
