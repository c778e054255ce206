"""Images as albedo: colour conversion, filtering, and sampling by texture coordinates."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from nbv.safe_files import require
from nbv.types import Floats, Floats32

Linear = Floats32
Real = TypeVar("Real", np.float32, np.float64)
FORMATS = ("PNG", "JPEG", "MPO", "WEBP", "TIFF", "BMP", "TGA", "GIF", "DDS", "JPEG2000")
MAX_PIXELS = 100_000_000  # 1.2 GB of linear values
_MAX_RASTERISED_FACES = 400_000


def linear_from_srgb(values: NDArray[Real]) -> NDArray[Real]:
    """Linear reflectance 0..1 from sRGB-encoded values 0..1 (IEC 61966-2-1), in their precision."""
    high = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, high)


def srgb_from_linear(radiance: NDArray[Real]) -> NDArray[Real]:
    """The inverse of `linear_from_srgb`, clipped to 0..1."""
    r = np.clip(radiance, 0.0, 1.0)
    return np.where(r <= 0.0031308, 12.92 * r, 1.055 * np.maximum(r, 1e-9) ** (1 / 2.4) - 0.055)


def linear_image(image: Image.Image) -> Linear:
    """(H, W, 3) linear values of an sRGB image of any mode; transparency is ignored.

    `ValueError` where its format is not among `FORMATS` (some of Pillow's readers start other programs) or its pixels have more
    than 8 bits; `UserError` for more than `MAX_PIXELS`, before they are decoded.
    """
    if image.format not in (*FORMATS, None):
        raise ValueError(f"{image.format} is no format of textures")
    if image.mode[0] in "IF":
        raise ValueError("its pixels have 16 or 32 bits; export it with 8")
    require(image.width * image.height, MAX_PIXELS, "the texture's number of pixels")
    table = linear_from_srgb((np.arange(256) / 255.0).astype(np.float32))
    return table[np.asarray(image.convert("RGB"))]


def shrink(image: Linear, factor: float) -> Linear:
    """The image averaged down by ``factor`` (1 or less: unchanged), against aliasing."""
    if factor <= 1.0:
        return image
    size = (max(1, round(image.shape[1] / factor)), max(1, round(image.shape[0] / factor)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def fill_gutters(image: Linear, corner_uv: Floats) -> Linear:
    """Give texels that no face uses the colour of the nearest used one.

    Filtering near a seam then never mixes in the background of the atlas. Left alone where coordinates
    leave 0..1 (a tiled texture has no background) and for very many faces. ``corner_uv`` is (F, 3, 2).
    """
    if corner_uv.min() < -1e-6 or corner_uv.max() > 1 + 1e-6 or len(corner_uv) > _MAX_RASTERISED_FACES:
        return image
    height, width = image.shape[:2]
    mask = Image.new("1", (width, height))
    draw = ImageDraw.Draw(mask)
    pixels = np.stack([corner_uv[..., 0] * width - 0.5, (1 - corner_uv[..., 1]) * height - 0.5], axis=-1)
    for triangle in pixels.reshape(-1, 6).tolist():
        draw.polygon(triangle, fill=1, outline=1)
    unused = ~np.asarray(mask)
    if not unused.any() or unused.all():
        return image
    rows, columns = scipy.ndimage.distance_transform_edt(unused, return_distances=False, return_indices=True)
    return image[rows, columns]


def sample(image: Linear, uv: Floats) -> Linear:
    """(N, 3) bilinear lookup at texture coordinates (N, 2), v up from the bottom row; beyond 0 to 1 the image repeats."""
    height, width = image.shape[:2]
    at = np.stack([(1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5])
    # A coordinate of exactly 1 means the last texel, not the first of the next repetition.
    mode = "grid-wrap" if uv.size and (uv.min() < 0 or uv.max() > 1) else "nearest"
    at_places = functools.partial(scipy.ndimage.map_coordinates, coordinates=at, order=1, mode=mode)
    return np.stack([at_places(image[..., c]) for c in range(3)], axis=1)


def texel_side(image: Linear, corner_uv: Floats, area: float) -> float:
    """Side of a texel on a surface of ``area`` whose corners have texture coordinates (F, 3, 2), in the mean."""
    ab, ac = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
    texels = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() * image.shape[0] * image.shape[1]
    return float(np.sqrt(area / max(texels, 1e-9)))


# A procedural albedo, a function of position, so that it needs no texture coordinates and never repeats; and the noise it is made of.
#
# The noise is seeded, aperiodic and three-dimensional, from an integer hash of lattice coordinates.


_U32 = NDArray[np.uint32]
# A fixed rotation between octaves keeps their lattices from lining up.
_TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
_AMPLITUDE = 4.4  # gives `gradient_noise` a standard deviation of 0.84


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
    step = np.clip((settles - threshold) / 0.35, 0.0, 1.0)
    cover = step * step * (3.0 - 2.0 * step)  # Hermite's
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


def _hash(x: _U32, y: _U32, z: _U32, seed: int) -> _U32:
    """One well-mixed 32-bit integer per lattice point (Murmur3's finaliser)."""
    h = x * np.uint32(0x9E3779B1)
    h ^= y * np.uint32(0x85EBCA77)
    h ^= z * np.uint32(0xC2B2AE3D)
    h ^= np.uint32((seed * 0x27D4EB2F + 0x165667B1) & 0xFFFFFFFF)
    h ^= h >> np.uint32(16)
    h *= np.uint32(0x85EBCA6B)
    h ^= h >> np.uint32(13)
    h *= np.uint32(0xC2B2AE35)
    h ^= h >> np.uint32(16)
    return h


def _lattice(points: Floats, wavelength: float) -> tuple[list[_U32], list[Floats32]]:
    """Cell indices and fractional positions along each axis."""
    scaled = points / wavelength
    floor = np.floor(scaled)
    cells = floor.astype(np.int64).astype(np.uint32)
    fractions = (scaled - floor).astype(np.float32)
    return [cells[:, i].copy() for i in range(3)], [fractions[:, i].copy() for i in range(3)]


def gradient_noise(points: Floats, wavelength: float, seed: int) -> Floats32:
    """Perlin's gradient noise at points (N, 3): (N,), zero mean, standard deviation 0.84.

    Perlin, "Improving noise", SIGGRAPH 2002 (quintic interpolation), with hashed gradients.
    """
    cells, fractions = _lattice(points, wavelength)
    fade = [f * f * f * (f * (f * np.float32(6) - np.float32(15)) + np.float32(10)) for f in fractions]
    total = np.zeros(len(points), dtype=np.float32)
    one = np.float32(1)
    for dx in (0, 1):
        wx = fade[0] if dx else one - fade[0]
        for dy in (0, 1):
            wxy = wx * (fade[1] if dy else one - fade[1])
            for dz in (0, 1):
                h = _hash(cells[0] + np.uint32(dx), cells[1] + np.uint32(dy), cells[2] + np.uint32(dz), seed)
                value = _component(h) * (fractions[0] - np.float32(dx))
                value += _component(h >> np.uint32(10)) * (fractions[1] - np.float32(dy))
                value += _component(h >> np.uint32(20)) * (fractions[2] - np.float32(dz))
                value *= wxy
                value *= fade[2] if dz else one - fade[2]
                total += value
    return total * np.float32(_AMPLITUDE)


def _component(h: _U32) -> Floats32:
    """A gradient component in [-1, 1] from the low ten bits."""
    return (h & np.uint32(1023)).astype(np.float32) * np.float32(2 / 1023) - np.float32(1)


def octaves(points: Floats, wavelengths: Sequence[float], amplitudes: Sequence[float], seed: int) -> Floats32:
    """Sum of gradient noises (N,) at points (N, 3) in metres, each octave in a rotated frame and with its own seed."""
    total = np.zeros(len(points), dtype=np.float32)
    turned = points
    for k, (wavelength, amplitude) in enumerate(zip(wavelengths, amplitudes)):
        turned = turned @ _TURN
        total += np.float32(amplitude) * gradient_noise(turned, wavelength, seed * 131 + k)
    return total


def cells(points: Floats, size: float, seed: int) -> tuple[_U32, Floats32]:
    """Irregular grains of about ``size``: a random integer per grain (N,) and the distance to its centre.

    The nearest of the eight jittered lattice points around each point (after Worley, "A cellular texture
    basis function", SIGGRAPH 1996). The distance is in units of ``size``.
    """
    shifted = points @ _TURN / size - 0.5
    floor = np.floor(shifted)
    base = floor.astype(np.int64).astype(np.uint32)
    fraction = (shifted - floor).astype(np.float32)
    best = np.full(len(points), np.inf, dtype=np.float32)
    label = np.zeros(len(points), dtype=np.uint32)
    for dx in (0, 1):
        for dy in (0, 1):
            for dz in (0, 1):
                h = _hash(
                    base[:, 0] + np.uint32(dx), base[:, 1] + np.uint32(dy), base[:, 2] + np.uint32(dz), seed
                )
                distance = np.zeros(len(points), dtype=np.float32)
                for axis, (corner, shift) in enumerate(zip((dx, dy, dz), (0, 10, 20))):
                    jitter = np.float32(0.35) * _component(h >> np.uint32(shift))
                    distance += (fraction[:, axis] - np.float32(corner) - jitter) ** 2
                closer = distance < best
                best[closer] = distance[closer]
                label[closer] = h[closer]
    # Mixed once more: the low bits placed the grain and must not also decide what it looks like.
    return _hash(label, label, label, seed + 1), np.sqrt(best)
