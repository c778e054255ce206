"""How well a mission predicts photographs that it could not take.

A second opinion that needs no reference: where was a photograph taken, by the mission's model, and how well does the
mission's dense cloud, seen from there, look like it (Waechter et al. 2017, "Virtual Rephotography")?
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.config import CameraConfig
from nbv.photogrammetric import PhotogrammetricReconstructor
from nbv.photographs.photograph_set import PhotographSet
from nbv.sparse.locating import Located
from nbv.types import Capture, Cloud, Floats, Viewpoint

PARTNERS = 4  # photographs of the mission that each is matched with
SHRINK = 4  # photographs are compared at a quarter of their size, where points of a cloud cover it
_NEAREST_M = 0.1


def judge_kept_out(
    photographs: PhotographSet,
    reconstructor: PhotogrammetricReconstructor,
    cloud: Cloud,
    object_m: Floats,
) -> dict[str, float | None]:
    """How well a mission predicts the photographs that it could not take; means over them, None where there is none.

    Parameters
    ----------
    photographs
        The set.
    reconstructor
        After ``finish``.
    cloud
        The mission's, as fused, in the world frame.
    object_m
        (N, 3) the reference: where in a photograph the object is.
    """
    asked = [p for p in photographs.registered if p.name in photographs.kept_out]
    found: list[Located] = []
    errors, seen = [], []
    for photograph in asked:
        assert photograph.camera_from_world is not None
        image = photographs.image(photograph.name)
        x, y, z = photograph.camera_center_m.tolist()
        place = Viewpoint("kept-out", (x, y, z), 0.0, 0.0, "lateral")
        capture = Capture(f"{photograph.name}.jpg", place, photograph.camera_from_world, image)
        located = reconstructor.locate(capture, PARTNERS)
        if located is not None:
            found.append(located)
        if cloud.colors is None:
            continue
        pose = photograph.camera_from_world if located is None else located.camera_from_world
        where = _splat(object_m, None, photograph.camera_from_world, photographs.camera)[1]
        error, share = photometric_error(image, cloud, pose, photographs.camera, where)
        errors.append(error)
        seen.append(share)

    def mean(values: list[float]) -> float | None:
        return float(np.mean(values)) if values else None

    return {
        "photographs": float(len(asked)),
        "registered_percent": 100.0 * len(found) / len(asked) if asked else None,
        "reprojection_error_px": mean([f.reprojection_error_px for f in found]),
        "photometric_error_percent": mean(errors),
        "covered_percent": mean(seen),
    }


def photometric_error(
    image: NDArray[np.uint8],
    cloud: Cloud,
    camera_from_world: Floats,
    camera: CameraConfig,
    where: NDArray[np.bool_],
) -> tuple[float, float]:
    """Mean absolute difference of grey (% of full scale) between a photograph and the cloud seen from there, and the share (%) of the object that the cloud covers.

    Over the pixels ``where`` (h, w) of the photograph at 1 / `SHRINK`; exposure is fitted (gain and offset). Where the
    cloud shows nothing the mean of what it shows is taken.

    Parameters
    ----------
    image
        (H, W, 3) RGB.
    cloud
        Points with colours.
    camera_from_world, camera
        Of the photograph.
    where
        (h, w) the object.
    """
    height, width = where.shape
    grey = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (width, height), interpolation=cv2.INTER_AREA)
    assert cloud.colors is not None
    values = cloud.colors.astype(float).mean(axis=1)
    drawn, covered = _splat(cloud.points_m, values, camera_from_world, camera)
    both = where & covered
    truth = grey.astype(float)
    if not where.any():
        return 0.0, 0.0
    predicted = np.full(where.shape, truth[where].mean())
    if both.sum() >= 2:
        gain, offset = (
            np.polyfit(drawn[both], truth[both], 1) if np.ptp(drawn[both]) > 0 else (0.0, truth[both].mean())
        )
        predicted[both] = gain * drawn[both] + offset
        predicted[where & ~covered] = predicted[both].mean()
    error = np.abs(predicted - truth)[where].mean() / 255.0
    return 100.0 * float(error), 100.0 * float(both.sum() / where.sum())


def _splat(
    points_m: Floats, values: Floats | None, camera_from_world: Floats, camera: CameraConfig
) -> tuple[Floats, NDArray[np.bool_]]:
    """(h, w) values (N,) of the nearest points (N, 3) at 1 / `SHRINK` of the camera's size, and where there is any.

    Holes of a pixel are closed. Nothing is drawn where there are no values.
    """
    height, width = camera.height_px // SHRINK, camera.width_px // SHRINK
    at = points_m @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    kept = at[:, 2] > _NEAREST_M
    at = at[kept]
    column, row = (
        np.floor((camera.focal_px * at[:, axis] / at[:, 2] + size / 2) / SHRINK).astype(int)
        for axis, size in ((0, camera.width_px), (1, camera.height_px))
    )
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    cell = row[inside] * width + column[inside]
    order = np.argsort(-at[inside, 2], kind="stable")  # the nearest is written last
    drawn = np.zeros(height * width)
    there = np.zeros(height * width, dtype=bool)
    there[cell] = True
    if values is not None:
        drawn[cell[order]] = values[kept][inside][order]
    picture, seen = drawn.reshape(height, width), there.reshape(height, width)
    closed = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0
    around = cv2.blur(picture, (3, 3)) / np.maximum(cv2.blur(seen.astype(float), (3, 3)), 1e-9)
    return np.where(seen, picture, around), closed
