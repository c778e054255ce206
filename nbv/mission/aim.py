"""Where a mission is ordered to: the middle of its rock, as whoever orders it knows it."""

from __future__ import annotations

import dataclasses

import numpy as np

from nbv.config import MissionConfig
from nbv.mission.belief import reaching_a_ring
from nbv.rocks import Rock
from nbv.rocks.families import generated_name

MARGIN_M = 0.1  # beyond the ends of a rock whose size is known


def aimed(config: MissionConfig, rock: Rock) -> MissionConfig:
    """``config`` about a drawn rock, whose height is its own: its middle is aimed at, and the crops reach beyond its ends.

    As it is about other rocks, which are 1.6 m high, and where another target was chosen.
    """
    if generated_name(rock.name) is None or config.target_m != MissionConfig().target_m:
        return config
    height_m = float(rock.vertices_m[:, 2].max())
    half_m = max(float(np.abs(rock.vertices_m[:, :2]).max()), height_m / 2)
    crop_m, measured_m = config.dense.crop_half_width_m, config.evaluation.crop_half_extent_m
    return reaching_a_ring(
        dataclasses.replace(
            config,
            target_m=(0.0, 0.0, round(height_m / 2, 3)),
            dense=dataclasses.replace(
                config.dense, crop_half_width_m=max(crop_m, round(half_m + MARGIN_M, 3))
            ),
            evaluation=dataclasses.replace(
                config.evaluation, crop_half_extent_m=max(measured_m, round(half_m + MARGIN_M, 3))
            ),
        )
    )
