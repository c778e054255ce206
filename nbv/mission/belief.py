"""Where a mission is ordered to, and what the vehicle believes of its target, before and after it has seen it."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.target import find_target
from nbv.random_streams import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.families import generated_name
from nbv.types import SparseModel
from nbv.viewpoints import raw_candidates

LOWEST_TARGET_M = 0.3  # nobody believes the target's centre to lie deeper
KNOWN_MARGIN_M = 0.1  # beyond the ends of a rock whose size is known
# Beyond the found target's longest half extent. Never less than configured: in hard light the seed model shows a part of
# the target, and a crop about that part cuts the rest off.
BOX_MARGIN_M, CROP_MARGIN_M = 1.0, 0.5
ROUNDING_M = 1e-6


def aimed(config: MissionConfig, rock: Rock) -> MissionConfig:
    """`about` a drawn rock, whose height is its own; as it is about others, which are 1.6 m high, and where a target was chosen."""
    if generated_name(rock.name) is None or config.target_m != MissionConfig().target_m:
        return config
    return reaching_a_ring(about(config, rock))


def about(config: MissionConfig, rock: Rock) -> MissionConfig:
    """``config`` about a rock whose place and size are known: aimed at its middle, with crops beyond its ends."""
    height_m = float(rock.vertices_m[:, 2].max())
    half_m = max(float(np.abs(rock.vertices_m[:, :2]).max()), height_m / 2)
    reach_m = round(half_m + KNOWN_MARGIN_M, 3)
    return config.changed(
        target_m=(0.0, 0.0, round(height_m / 2, 3)),
        dense={"crop_half_width_m": max(config.dense.crop_half_width_m, reach_m)},
        evaluation={"crop_half_extent_m": max(config.evaluation.crop_half_extent_m, reach_m)},
    )


def believed(config: MissionConfig, rock_sha256: str, replicate: int) -> MissionConfig:
    """``config`` with the target where it is believed to be: off by `TargetConfig`, drawn per (rock, replicate)."""
    sd = config.target
    if sd.is_known:
        return config
    east, north, up = keyed_rng("target-belief", rock_sha256, replicate).standard_normal(3).tolist()
    x, y, z = config.target_m
    return config.changed(
        target_m=(
            x + sd.horizontal_sd_m * east,
            y + sd.horizontal_sd_m * north,
            max(z + sd.vertical_sd_m * up, LOWEST_TARGET_M),
        )
    )


def located(config: MissionConfig, model: SparseModel) -> MissionConfig | None:
    """``config`` with the target's place and size as the model shows them; None where none is found in it.

    Where telemetry errs altitudes count from the ground in the model: what telemetry calls zero is off by its drift.
    """
    found = find_target(model.points_m, config.target_m)
    if found is None:
        return None
    half_m = found.half_extent_m
    if not config.telemetry.is_exact:
        config = above_ground(config, found.ground_m)
    return reaching_a_ring(
        config.changed(
            target_m=found.center_m,
            shared={"box_half_extent_m": max(config.shared.box_half_extent_m, half_m + BOX_MARGIN_M)},
            dense={"crop_half_width_m": max(config.dense.crop_half_width_m, half_m + CROP_MARGIN_M)},
        )
    )


def reaching_a_ring(config: MissionConfig) -> MissionConfig:
    """``config`` whose pool's ceiling lets the lowest ring pass that may be flown.

    Rings stand about the found target. A ceiling that was tuned for "as low as one may fly" lies a hand above the lowest
    ring; where the target is found a little higher, or the ring now lies below the lowest flight, nothing would be left.
    """
    pool = config.pool
    flyable = [z for z in (v.position_m[2] for v in raw_candidates(config)) if z >= pool.min_altitude_m]
    if not flyable or min(flyable) <= pool.max_altitude_m:
        return config
    return config.changed(pool={"max_altitude_m": min(flyable) + ROUNDING_M})


def above_ground(config: MissionConfig, ground_m: float) -> MissionConfig:
    """``config`` with its altitudes, which count from the ground, in a frame whose ground lies at ``ground_m``."""
    pool, flight = config.pool, config.flight
    return config.changed(
        pool={
            "min_altitude_m": pool.min_altitude_m + ground_m,
            "max_altitude_m": pool.max_altitude_m + ground_m,
        },
        flight={
            "keep_out_height_m": max(0.0, flight.keep_out_height_m + ground_m),
            "min_camera_altitude_m": max(0.0, flight.min_camera_altitude_m + ground_m),
        },
    )


def must_look(config: MissionConfig) -> bool:
    """Whether the target has to be looked for: it, or the vehicle's own place, is known only roughly."""
    return not (config.target.is_known and config.telemetry.is_exact)
