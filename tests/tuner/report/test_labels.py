"""Names, units and numbers for people."""

from __future__ import annotations

from nbv.config import parameter_paths
from tuner.report.labels import (
    parameter_label,
)


def test_every_parameter_has_a_label_that_tells_it_apart() -> None:
    labels = [parameter_label(path) for path in parameter_paths()]
    assert len({label.name for label in labels}) == len(labels)
    assert parameter_label("gate.d95_m").unit == "m"
    assert parameter_label("covis.weights.nov").name == "Covis: weight W_nov"
