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
    """`about` a drawn rock, whose height is its own; as it is about others, which are 1.6 m high, and where a target was chosen."""
    if generated_name(rock.name) is None or config.target_m != MissionConfig().target_m:
        return config
    return reaching_a_ring(about(config, rock))


def about(config: MissionConfig, rock: Rock) -> MissionConfig:
    """``config`` about a rock whose place and size are known: aimed at its middle, with crops beyond its ends."""
    height_m = float(rock.vertices_m[:, 2].max())
    half_m = max(float(np.abs(rock.vertices_m[:, :2]).max()), height_m / 2)
    reach_m = round(half_m + MARGIN_M, 3)
    dense, evaluation = config.dense, config.evaluation
    return dataclasses.replace(
        config,
        target_m=(0.0, 0.0, round(height_m / 2, 3)),
        dense=dataclasses.replace(dense, crop_half_width_m=max(dense.crop_half_width_m, reach_m)),
        evaluation=dataclasses.replace(
            evaluation, crop_half_extent_m=max(evaluation.crop_half_extent_m, reach_m)
        ),
    )
