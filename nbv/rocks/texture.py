"""Images as albedo: colour conversion, filtering, and sampling by texture coordinates."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, map_coordinates

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
    rows, columns = distance_transform_edt(unused, return_distances=False, return_indices=True)
    return image[rows, columns]


def sample(image: Linear, uv: Floats) -> Linear:
    """(N, 3) bilinear lookup at texture coordinates (N, 2), v up from the bottom row; beyond 0 to 1 the image repeats."""
    height, width = image.shape[:2]
    at = np.stack([(1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5])
    # A coordinate of exactly 1 means the last texel, not the first of the next repetition.
    mode = "grid-wrap" if uv.size and (uv.min() < 0 or uv.max() > 1) else "nearest"
    return np.stack([map_coordinates(image[..., c], at, order=1, mode=mode) for c in range(3)], axis=1)


def texel_side(image: Linear, corner_uv: Floats, area: float) -> float:
    """Side of a texel on a surface of ``area`` whose corners have texture coordinates (F, 3, 2), in the mean."""
    ab, ac = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
    texels = 0.5 * np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]).sum() * image.shape[0] * image.shape[1]
    return float(np.sqrt(area / max(texels, 1e-9)))
