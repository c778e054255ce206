"""The ground never repeats, and is the same landscape at every level."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from nbv.scene.ground import GroundSpec, synthesise_ground

SPEC = GroundSpec(texel_m=0.012, size_px=1024, levels=3)
TO_SUN = np.array([0.0, -0.625, 0.78]) / np.hypot(0.625, 0.78)


@pytest.fixture(scope="module")
def ground():
    return synthesise_ground(0, TO_SUN, SPEC)


def strongest_repeat(texture: np.ndarray, shortest_lag: int) -> float:
    """Largest autocorrelation (zero-padded, fine detail only) at any lag of at least ``shortest_lag``."""
    detail = texture - cv2.GaussianBlur(texture, (0, 0), 6)
    detail -= detail.mean()
    size = 2 * np.array(detail.shape)
    power = np.abs(np.fft.rfft2(detail, size)) ** 2
    correlation = np.fft.irfft2(power, size)
    overlap = np.fft.irfft2(np.abs(np.fft.rfft2(np.ones_like(detail), size)) ** 2, size)
    correlation = correlation / correlation[0, 0] * detail.size / np.maximum(overlap, 1)
    lag = np.minimum(np.arange(size[0]), size[0] - np.arange(size[0]))
    far = np.maximum(lag[:, None], lag[None, : correlation.shape[1]]) >= shortest_lag
    enough = overlap > 0.1 * detail.size  # tiny overlaps correlate by chance
    return float(correlation[far & enough].max())


@pytest.mark.slow
def test_the_ground_has_no_period(ground):
    for textures in ground:
        for texture in textures:
            assert strongest_repeat(texture, 24) < 0.15
