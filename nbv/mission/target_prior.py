"""The true target for what measures, and the vehicle's estimate of it before and after it has been seen."""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.geometry.target import find_target
from nbv.process import keyed_rng
from nbv.rocks import Rock
from nbv.rocks.families import generated_name
from nbv.rocks.rock import DEFAULT_HEIGHT_M
from nbv.types import SparseModel
from nbv.viewpoints import raw_candidates

LOWEST_TARGET_M = 0.3  # the assumed centre of the target lies no deeper
KNOWN_MARGIN_M = 0.1  # beyond the ends of a rock as large as it may be
# Beyond the found target's longest half extent. Never less than configured: in hard light the seed model shows a part of
# the target, and a crop about that part cuts the rest off.
BOX_MARGIN_M, CROP_MARGIN_M = 1.0, 0.5
ROUNDING_M = 1e-6
SAME_HEIGHT = 0.01  # relative: an imported rock is as high as `MissionConfig.target_m` takes it to be


def with_true_target(config: MissionConfig, rock: Rock) -> MissionConfig:
    """``config`` with the true target of a rock that is generated or not 1.6 m high: for metrics alone, never for planning.

    Unchanged for other rocks, and where the user has set a target.
    """
    return with_target_size(config, *_size_m(rock)) if _has_own_size(config, rock) else config


def with_size_error(config: MissionConfig, rock: Rock, replicate: int) -> MissionConfig:
    """``config`` with the target and the crops that follow from the prior size of a rock that is generated or not 1.6 m high.

    A generated rock's is off by up to ``target.size_error_percent``: one uniform error for height and width, drawn per (rock,
    replicate); the crops leave room for it. For any other rock, or a target that was set, ``config`` itself.
    """
    if not _has_own_size(config, rock):
        return config
    error = 0.0 if generated_name(rock.name) is None else config.target.size_error_percent / 100.0
    drawn = 1.0 + error * keyed_rng("size-belief", rock.name, replicate).uniform(-1.0, 1.0)
    height_m, half_width_m = (drawn * size_m for size_m in _size_m(rock))
    return reaching_a_ring(with_target_size(config, height_m, half_width_m, 1.0 / (1.0 - error)))


def _has_own_size(config: MissionConfig, rock: Rock) -> bool:
    if config.target_m != MissionConfig().target_m:
        return False
    return generated_name(rock.name) is not None or abs(_size_m(rock)[0] / DEFAULT_HEIGHT_M - 1) > SAME_HEIGHT


def _size_m(rock: Rock) -> tuple[float, float]:
    return float(rock.vertices_m[:, 2].max()), float(np.abs(rock.vertices_m[:, :2]).max())


def with_target_size(
    config: MissionConfig, height_m: float, half_width_m: float, at_most: float = 1.0
) -> MissionConfig:
    """``config`` for a rock of this height and half width: cameras aim at half the height, crops hold one ``at_most`` times as large."""
    reach_m = round(at_most * max(half_width_m, height_m / 2) + KNOWN_MARGIN_M, 3)
    return config.changed(
        target_m=(0.0, 0.0, round(height_m / 2, 3)),
        dense={"crop_half_width_m": max(config.dense.crop_half_width_m, reach_m)},
        evaluation={"crop_half_extent_m": max(config.evaluation.crop_half_extent_m, reach_m)},
    )


def with_target_error(config: MissionConfig, rock_sha256: str, replicate: int) -> MissionConfig:
    """``config`` with the target where the vehicle assumes it: off by `TargetConfig`, drawn per (rock, replicate)."""
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


def with_target_found(config: MissionConfig, model: SparseModel) -> MissionConfig | None:
    """``config`` with the target's place and size as the model shows them; None where none is found in it.

    Where telemetry errs altitudes count from the ground in the model: what telemetry calls zero is off by its drift.
    """
    target = find_target(model.points_m, config.target_m)
    if target is None:
        return None
    half_m = target.half_extent_m
    if not config.telemetry.is_exact:
        pool, flight, ground_m = config.pool, config.flight, target.ground_m
        config = config.changed(
            target={"ground_m": ground_m},
            pool={
                "min_altitude_m": pool.min_altitude_m + ground_m,
                "max_altitude_m": pool.max_altitude_m + ground_m,
            },
            flight={
                "keep_out_height_m": max(0.0, flight.keep_out_height_m + ground_m),
                "min_camera_altitude_m": max(0.0, flight.min_camera_altitude_m + ground_m),
            },
        )
    return reaching_a_ring(
        config.changed(
            target_m=target.center_m,
            shared={"box_half_extent_m": max(config.shared.box_half_extent_m, half_m + BOX_MARGIN_M)},
            dense={"crop_half_width_m": max(config.dense.crop_half_width_m, half_m + CROP_MARGIN_M)},
        )
    )


def reaching_a_ring(config: MissionConfig) -> MissionConfig:
    """``config`` with its pool's ceiling above the lowest ring that may be flown.

    Rings stand about the found target. A ceiling that was tuned for "as low as one may fly" lies a hand above the lowest
    ring; where the target is found a little higher, or the ring now lies below the lowest flight, nothing would be left.
    """
    pool = config.pool
    flyable = [z for z in (v.position_m[2] for v in raw_candidates(config)) if z >= pool.min_altitude_m]
    if not flyable or min(flyable) <= pool.max_altitude_m:
        return config
    return config.changed(pool={"max_altitude_m": min(flyable) + ROUNDING_M})


def target_must_be_found(config: MissionConfig) -> bool:
    """Whether the target has to be looked for: it, or the vehicle's own place, is known less well than photographs show it."""
    return not (config.target.is_known and config.telemetry.places_well)
