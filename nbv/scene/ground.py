"""An endless, aperiodic regolith: albedo and micro-relief of the plane z = 0, shaded once.

The ground is a clipmap: level ``l`` is a square texture of ``size_px`` texels of
``texel_m * 2**l`` centred on the origin, so the middle is sharp and the horizon cheap. Every level holds
the same landscape band-limited to its own texels, which is what a prefiltered mip-map is.

Nothing here repeats: a tiled ground photograph makes Structure-from-Motion build self-consistent but
wrong models, because a patch matches its neighbour's copy.

Its own small relief is painted on, not modelled: the surface is exactly z = 0, so depth has a closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.process import keyed_rng
from nbv.types import Floats32

MEAN_ALBEDO = 0.21  # linear; lunar mare to highland is 0.07 to 0.25
LARGEST_NODE_M = 12.8  # node spacing of the coarsest noise octave
PEBBLES_PER_CLASS = 4800
CRATERS_PER_CLASS = 700
SMALLEST_DISC_TEXELS = 1.5  # radius; below this a disc aliases and is left out of a level


@dataclass(frozen=True)
class GroundSpec:
    """Size of the clipmap; the default reaches 98 m with 6 mm texels in the middle 12 m."""

    texel_m: float = 0.006
    size_px: int = 2048
    levels: int = 5

    def half_extent_m(self, level: int) -> float:
        """Half the side of a level's square."""
        return self.texel_m * 2**level * self.size_px / 2

    @property
    def reach_m(self) -> float:
        """Half extent of the coarsest level; beyond it the ground has its mean radiance."""
        return self.half_extent_m(self.levels - 1)


def synthesise_ground(
    seed: int, to_sun: NDArray[np.float64], spec: GroundSpec
) -> list[tuple[Floats32, Floats32]]:
    """Paint the ground of one seed: per level the albedo (S, S), linear, and the sun cosine (S, S).

    The sun cosine is max(0, n . l), with the pebbles' own shadows; ``to_sun`` (3,) is a unit vector with z > 0. Texel
    (row i, column j) is centred on ``x = (j + 0.5) * texel - half``, ``y = (i + 0.5) * texel - half``.
    """
    shape = (spec.size_px, spec.size_px)
    textures = [
        _Textures(np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.ones(shape, np.float32))
        for _ in range(spec.levels)
    ]

    octaves = int(np.floor(np.log2(LARGEST_NODE_M / spec.texel_m))) + 1
    for octave in range(octaves):
        node_m = spec.texel_m * 2**octave
        slope = 0.16 if node_m < 0.1 else 0.07
        contrast = 0.13 if node_m < 0.1 else 0.07
        for kind, amplitude in (("height", slope * node_m), ("albedo", contrast)):
            lattice = _lattice(seed, kind, octave, spec)
            for level in range(min(octave + 1, spec.levels)):
                target = textures[level].height if kind == "height" else textures[level].log_albedo
                target += amplitude * _upsample(lattice, octave, level, spec)
    _scatter_discs(seed, to_sun, spec, textures)

    painted = []
    for level, texture in enumerate(textures):
        slope_y, slope_x = np.gradient(texture.height, np.float32(spec.texel_m * 2**level))
        cosine = (to_sun[2] - slope_x * to_sun[0] - slope_y * to_sun[1]) / np.sqrt(
            1 + slope_x**2 + slope_y**2
        )
        albedo = np.clip(MEAN_ALBEDO * np.exp(texture.log_albedo), 0.03, 0.6).astype(np.float32)
        painted.append((albedo, (np.maximum(cosine, 0) * texture.shade).astype(np.float32)))
    return painted


@dataclass(frozen=True)
class _Textures:
    """What is painted on one level of the clipmap, (S, S) each."""

    height: Floats32  # in metres
    log_albedo: Floats32
    shade: Floats32  # share of the sun that stones leave


def _lattice(seed: int, kind: str, octave: int, spec: GroundSpec) -> Floats32:
    """Smooth unit-variance noise on nodes ``texel * 2**octave`` apart over the coarsest level that sees it."""
    nodes = max(4, spec.size_px >> max(0, octave - (spec.levels - 1)))
    white = keyed_rng("ground", seed, kind, octave).standard_normal((nodes, nodes), dtype=np.float32)
    # The blur makes blobs round: interpolated white noise alone shows its lattice.
    smooth = cv2.GaussianBlur(white, (0, 0), 0.8, borderType=cv2.BORDER_REFLECT)
    return smooth / np.float32(0.5 / (np.sqrt(np.pi) * 0.8))


def _upsample(lattice: Floats32, octave: int, level: int, spec: GroundSpec) -> Floats32:
    """The part of an octave inside a level, at the level's texels; both are centred on the origin."""
    remaining = 2 ** (octave - level)
    grid = lattice
    while remaining > 1:
        step = min(remaining, 8)  # in steps: the whole lattice blown up at once would not fit in memory
        needed = int(np.ceil(spec.size_px / remaining / 2)) * 2 + 4
        grid = _central(grid, needed)
        size = len(grid) * step
        grid = cv2.resize(grid, (size, size), interpolation=cv2.INTER_CUBIC)
        remaining //= step
    return _central(grid, spec.size_px)


def _central(grid: Floats32, size: int) -> Floats32:
    """The central ``size`` square of an even-sized grid (all of it if it is smaller)."""
    start = max(0, (len(grid) - size) // 2)
    return np.ascontiguousarray(grid[start : len(grid) - start, start : len(grid) - start])


def _scatter_discs(
    seed: int, to_sun: NDArray[np.float64], spec: GroundSpec, textures: list[_Textures]
) -> None:
    """Pebbles of 1 to 4 cm radius and craters up to 5 m, each size class over the levels that resolve it."""
    shadow_shift = -to_sun[:2] / to_sun[2]
    size_class = 0
    while 0.010 * 2**size_class < 4.0:
        pebble = size_class < 2
        coarsest = min(size_class, spec.levels - 1)
        extent = spec.half_extent_m(coarsest)
        rng = keyed_rng("ground discs", seed, size_class)
        count = PEBBLES_PER_CLASS if pebble else CRATERS_PER_CLASS
        # Density falls with the square of the size; the class's own area grows by the same factor.
        area_ratio = (extent / (6.144 * 2**size_class)) ** 2
        count = max(1, round(count * area_ratio))
        centres = rng.uniform(-extent, extent, (count, 2))
        radii = 0.010 * 2**size_class * 2 ** rng.uniform(0, 1, count)
        tones = rng.normal(0, 0.25 if pebble else 0.06, count)
        steep = rng.uniform(0.5, 1.0, count)
        for level in range(coarsest + 1):
            texel, half = spec.texel_m * 2**level, spec.half_extent_m(level)
            inside = (np.abs(centres) < half + 2 * radii[:, None]).all(axis=1)
            for i in np.flatnonzero(inside & (radii >= SMALLEST_DISC_TEXELS * texel)):
                disc = _Disc(centres[i], radii[i], texel, half)
                if pebble:
                    shadow = _Disc(centres[i] + 0.35 * radii[i] * shadow_shift, radii[i], texel, half)
                    _draw_pebble(disc, shadow, 0.5 * steep[i], tones[i], textures[level])
                else:
                    _draw_crater(disc, 0.16 * steep[i], tones[i], textures[level])
        size_class += 1


@dataclass(frozen=True)
class _Disc:
    """A circle on one level of the clipmap."""

    center_m: NDArray[np.float64]  # (2,)
    radius_m: float
    texel_m: float
    half_m: float  # half extent of the level

    def window(self, texture: Floats32, reach: float) -> tuple[Floats32, Floats32]:
        """The part (a view) of the texture within ``reach`` radii, and its distances from the centre in radii."""
        column, row = (self.center_m + self.half_m) / self.texel_m - 0.5
        span = reach * self.radius_m / self.texel_m
        c0, c1 = max(0, math.ceil(column - span)), max(0, math.floor(column + span) + 1)
        r0, r1 = max(0, math.ceil(row - span)), max(0, math.floor(row + span) + 1)
        part = texture[r0:r1, c0:c1]
        dy = np.arange(r0, r0 + part.shape[0], dtype=np.float32) - np.float32(row)
        dx = np.arange(c0, c0 + part.shape[1], dtype=np.float32) - np.float32(column)
        return part, np.hypot(dy[:, None], dx) * np.float32(self.texel_m / self.radius_m)


def _draw_pebble(disc: _Disc, shadow: _Disc, steepness: float, tone: float, on: _Textures) -> None:
    """A half-buried stone with a tone and a shadow of its own."""
    part, d = shadow.window(on.shade, 1.0)
    part *= 1 - 0.8 * np.clip(4 * (1 - d), 0, 1)
    part, d = disc.window(on.shade, 0.9)
    part[d < 0.9] = 1
    part, d = disc.window(on.log_albedo, 1.0)
    part += tone * np.clip(3 * (1 - d), 0, 1)
    part, d = disc.window(on.height, 1.0)
    part += steepness * disc.radius_m * np.maximum(1 - d * d, 0)


def _draw_crater(disc: _Disc, steepness: float, tone: float, on: _Textures) -> None:
    """A bowl with a low rim, a little brighter or darker than its surroundings."""
    part, d = disc.window(on.height, 1.6)
    bowl = np.minimum(d * d - 1, 0) + 0.25 * np.exp(-(((d - 1) / 0.2) ** 2))
    part += steepness * disc.radius_m * bowl
    part, d = disc.window(on.log_albedo, 1.2)
    part += tone * np.clip(1.5 * (1.2 - d), 0, 1)
