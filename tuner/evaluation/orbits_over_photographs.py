"""Plain orbits over sets of photographs: as high as these were taken, since nobody stood at 10 degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nbv.config import MissionConfig
from nbv.photographs import PhotographSet
from nbv.rocks.imported import are_photographed
from tuner.evaluation.baselines import is_orbit

HIGHEST_DEG = 60.0


def where_photographed(
    strategies: Mapping[str, MissionConfig], rocks: Sequence[str]
) -> tuple[dict[str, MissionConfig], tuple[str, ...]]:
    """``strategies`` whose plain orbits fly where the photographs are, if all ``rocks`` are sets, and a note that says so.

    One ring flies at the median elevation of all photographs, two rings at their quartiles.
    """
    if not are_photographed(rocks) or not any(map(is_orbit, strategies)):
        return dict(strategies), ()
    elevations_deg = np.concatenate([PhotographSet.read(rock).coverage.elevations_deg for rock in rocks])
    low, middle, high = np.percentile(elevations_deg, [25, 50, 75]).clip(0.0, HIGHEST_DEG).round(1).tolist()

    def placed(config: MissionConfig) -> MissionConfig:
        one = config.seed.upper_share == 0
        ring = {"seed.lowest_deg": middle if one else low, "seed.span_deg": 0.0 if one else high - low}
        return config.with_values(ring)

    note = (
        f"Plain orbits fly where the photographs were taken: one ring at {middle:g}° (the median), two at {low:g}° and "
        f"{high:g}° (the quartiles)."
    )
    return {name: placed(c) if is_orbit(name) else c for name, c in strategies.items()}, (note,)
