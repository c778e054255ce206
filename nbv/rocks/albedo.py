"""A procedural albedo: a function of position, so it needs no texture coordinates and never repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nbv.rocks.noise import cells, gradient_noise, octaves, smooth_step
from nbv.types import Floats, Floats32


@dataclass(frozen=True)
class Paint:
    """What a rock's surface looks like."""

    grey: float = 0.34  # mean linear reflectance
    clasts: float = 0.5  # 0 to 1, strength of embedded fragments of 2 to 8 cm
    grains: float = 0.5  # 0 to 1, strength of mineral grains of about 2 cm
    dust: float = 0.42  # 0 to 1, how much of the rock lies under dust and shows little texture


def procedural_albedo(points: Floats, normals: Floats, seed: int, paint: Paint | None = None) -> Floats32:
    """Linear albedo (N, 3) in 0..1 at surface points (N, 3) in metres with unit normals (N, 3).

    Mottling from 0.5 m down to 1.5 cm, clasts, mineral grains about two pixels wide (8.6 mm a pixel at 4 m; finer ones would alias
    and match nothing), and patches of dust, chiefly on faces that look up, where the texture fades to a seventh.
    """
    paint = paint or Paint()
    mottling = octaves(
        points, (0.50, 0.21, 0.09, 0.045, 0.026, 0.015), (0.10, 0.10, 0.10, 0.10, 0.10, 0.08), seed
    )
    contrast = mottling.astype(np.float32)
    for k, (size, share) in enumerate(((0.080, 0.22), (0.042, 0.30))):
        label, distance = cells(points, size, seed * 17 + k)
        tone = _unit(label, 0) - np.float32(0.45)
        inside = (_unit(label, 16) < share) & (distance < 0.25 + 0.25 * _unit(label, 8))
        contrast += np.float32(1.4 * paint.clasts) * np.where(inside, tone, np.float32(0))
    label, _ = cells(points, 0.016, seed * 17 + 5)
    contrast += np.float32(0.6 * paint.grains) * (_unit(label, 0) - np.float32(0.5))
    dark, _ = cells(points, 0.024, seed * 17 + 6)
    contrast -= np.float32(0.7 * paint.grains) * (_unit(dark, 0) < 0.12)

    settles = 0.9 * normals[:, 2] + 0.9 * gradient_noise(points, 0.45, seed * 17 + 9)
    threshold = 1.5 - 3.0 * paint.dust
    cover = smooth_step((settles - threshold) / 0.35)
    contrast *= (1.0 - 0.85 * cover).astype(np.float32)
    grey = paint.grey * np.exp(np.float32(1.2) * contrast + np.float32(0.12) * cover)

    # A slight drift between warmer and cooler greys, as basalt and plagioclase have.
    warmth = 0.02 * gradient_noise(points, 0.16, seed * 17 + 11) + 0.02
    tint = np.stack([1.0 + warmth, np.ones_like(warmth), 1.0 - 1.3 * warmth], axis=1)
    return np.clip(grey[:, None] * tint, 0.02, 0.95).astype(np.float32)


def _unit(label: NDArray[np.uint32], shift: int) -> Floats32:
    """A number in [0, 1) from sixteen bits of a label, the bits rotated by ``shift``."""
    turned = (label >> np.uint32(shift)) | (label << np.uint32((32 - shift) % 32))
    return ((turned & np.uint32(0xFFFF)).astype(np.float32)) / np.float32(65536)
