"""Names, units and numbers for people."""

from __future__ import annotations

import math

from nbv.config import parameter_paths
from tuner.report.labels import (
    decimals_for,
    format_number,
    parameter_label,
    parameter_value,
    with_unit,
)


def test_every_parameter_has_a_label_that_tells_it_apart() -> None:
    labels = [parameter_label(path) for path in parameter_paths()]
    assert len({label.name for label in labels}) == len(labels)
    assert parameter_label("gate.d95_m").unit == "m"
    assert parameter_label("covis.weights.nov").name == "Covis: weight W_nov"


def test_numbers() -> None:
    assert format_number(-1.25, 1) == "−1.2" and format_number(2.0, 2, signed=True) == "+2.00"
    assert format_number(-0.004, 2) == "0.00"  # no negative zero
    assert with_unit(None, "mm") == "–" and with_unit(math.nan, "%") == "–"
    assert with_unit(3.14159, "mm", 2) == "3.14 mm"
    assert [decimals_for(s) for s in (25.0, 1.2, 0.12, 0.0)] == [1, 1, 2, 1]
    assert parameter_value(0.123456) == "0.1235" and parameter_value(6) == "6"
    assert parameter_value("occlusion") == "occlusion"
