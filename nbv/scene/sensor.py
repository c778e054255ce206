"""Sensor noise, keyed by what is photographed: the same view is the same photograph in every mission."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.config import SceneConfig
from nbv.random_streams import keyed_rng
from nbv.scene.bake import RockLike
from nbv.scene.view import Renderer
from nbv.types import Floats


def noise_rng(rock_sha256: str, replicate: int, viewpoint_id: str) -> np.random.Generator:
    """The noise generator of one photograph."""
    return keyed_rng("sensor noise", rock_sha256, replicate, viewpoint_id)


def add_sensor_noise(
    rgb: NDArray[np.uint8], config: SceneConfig, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """(H, W, 3) with Gaussian read noise and signal-dependent shot noise, rounded and clipped.

    The variance of a value v is ``read_noise_dn**2 + shot_noise_dn**2 * v / 255``, independent per
    pixel and channel.
    """
    levels = np.arange(256, dtype=np.float32)
    deviation = np.sqrt(config.read_noise_dn**2 + config.shot_noise_dn**2 * levels / 255).astype(np.float32)
    noisy = rng.standard_normal(rgb.shape, dtype=np.float32)
    noisy *= deviation[rgb]
    noisy += rgb
    np.rint(noisy, out=noisy)
    return np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)


def photograph(
    renderer: Renderer,
    camera_from_world: Floats,
    rock: RockLike,
    replicate: int,
    viewpoint_id: str,
    config: SceneConfig,
) -> NDArray[np.uint8]:
    """(H, W, 3) RGB with sensor noise; a function of its arguments alone."""
    clean = renderer.rgb(camera_from_world)
    return add_sensor_noise(clean, config, noise_rng(rock.sha256, replicate, viewpoint_id))
