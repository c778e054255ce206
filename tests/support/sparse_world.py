"""A small world of labelled points, so that the mapper can be tested without rendering or SIFT."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike
from scene_helpers import around

from nbv.config import CameraConfig, MissionConfig, SparseConfig, TelemetryConfig
from nbv.geometry.frames import camera_centers_m, intrinsic_matrix, look_at
from nbv.process import Stopwatch
from nbv.sparse.features import Features, VerifiedPair
from nbv.types import Capture, Viewpoint

CAMERA = CameraConfig()
TARGET = np.array([0.0, 0.0, 0.8])
CALIBRATED = 2


def ring_captures(count: int, radius_m: float = 4.0, start: int = 0, turn_deg: float = 0.0) -> list[Capture]:
    """Captures on rings of 12 at 15 and 35 degrees; each photograph is filled with its index."""
    captures = []
    for i in range(start, start + count):
        upper = (i // 12) % 2
        azimuth, elevation = turn_deg + 30.0 * (i % 12) + 15.0 * upper, 15.0 + 20.0 * upper
        position = around(azimuth, elevation, radius_m)
        name = f"view_{i:02d}.png"
        image = np.full((CAMERA.height_px, CAMERA.width_px, 3), i, np.uint8)
        viewpoint = Viewpoint(name, tuple(position), azimuth, elevation, "seed")
        captures.append(Capture(name, viewpoint, look_at(position, TARGET), image))
    return captures


class LabelledPoints:
    """``Correspondences`` that project known points with noise and match them by label."""

    def __init__(self, captures: list[Capture], points: int = 500, noise_px: float = 0.3) -> None:
        self.stopwatch = Stopwatch()
        self.blind: set[int] = set()  # captures that see nothing, by index
        self.only_with: dict[int, set[int]] = {}  # capture -> the only captures it matches
        rng = np.random.default_rng(7)
        normals = rng.standard_normal((points, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        ground = np.c_[rng.uniform(-3, 3, (points, 2)), np.zeros(points)]
        self.points_m = np.concatenate([TARGET + 0.8 * normals, ground])
        outward = np.concatenate([normals, np.tile([0.0, 0.0, 1.0], (points, 1))])
        threshold = np.r_[np.full(points, 0.3), np.zeros(points)]
        matrix = intrinsic_matrix(CAMERA)
        self.labels: dict[int, np.ndarray] = {}
        self.pixels: dict[int, np.ndarray] = {}
        self.centers: dict[int, np.ndarray] = {}
        for capture in captures:
            index = int(capture.image[0, 0, 0])
            in_camera = self.points_m @ capture.camera_from_world[:3, :3].T + capture.camera_from_world[:3, 3]
            pixels = in_camera @ matrix.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            towards = camera_centers_m(capture.camera_from_world) - self.points_m
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            seen = (
                ((towards * outward).sum(1) > threshold)
                & (in_camera[:, 2] > 0.1)
                & (pixels > 0).all(1)
                & (pixels < [CAMERA.width_px, CAMERA.height_px]).all(1)
            )
            labels = np.flatnonzero(seen)
            noise = np.random.default_rng(100 + index).normal(0, noise_px, (len(labels), 2))
            self.labels[index] = labels
            self.pixels[index] = pixels[labels] + noise
            self.centers[index] = camera_centers_m(capture.camera_from_world)

    def features(self, image: np.ndarray) -> Features:
        index = int(image[0, 0, 0])
        labels = self.labels[index] if index not in self.blind else np.zeros(0, int)
        keypoints = np.zeros((len(labels), 4), np.float32)
        if len(labels):
            keypoints[:, :2] = self.pixels[index]
        descriptors = np.zeros((len(labels), 128), np.uint8)
        descriptors[:, 0], descriptors[:, 1] = labels % 256, labels // 256
        if len(labels):
            descriptors[:, 2] = index
        return Features(keypoints, descriptors)

    def pair(self, a: Features, b: Features) -> VerifiedPair:
        none = VerifiedPair(np.zeros((0, 2), np.uint32), 1)
        if len(a) == 0 or len(b) == 0:
            return none
        first, second = int(a.descriptors[0, 2]), int(b.descriptors[0, 2])
        for one, other in ((first, second), (second, first)):
            if other not in self.only_with.get(one, {other}):
                return none
        u, v = self.centers[first] - TARGET, self.centers[second] - TARGET
        if u @ v < np.cos(np.radians(65.0)) * np.linalg.norm(u) * np.linalg.norm(v):
            return none  # as with SIFT, very different views do not match
        label_a, label_b = (f.descriptors[:, :2].astype(int) @ [1, 256] for f in (a, b))
        _, i, j = np.intersect1d(label_a, label_b, return_indices=True)
        return VerifiedPair(np.stack([i, j], 1).astype(np.uint32), CALIBRATED)


CONFIG = SparseConfig(min_registered_seeds=8, global_ba_interval=4)


def mission(sparse: SparseConfig, telemetry: TelemetryConfig | None = None) -> MissionConfig:
    """The default configuration with these sections."""
    return MissionConfig().changed(sparse=sparse, telemetry=telemetry or TelemetryConfig())


def moved(pose: np.ndarray, offset_m: ArrayLike) -> np.ndarray:
    """The same orientation, its centre moved by ``offset_m``."""
    other = pose.copy()
    other[:3, 3] -= pose[:3, :3] @ np.asarray(offset_m, float)
    return other


def reported(capture: Capture, offset_m: ArrayLike) -> Capture:
    """As telemetry that errs by ``offset_m`` has it."""
    return dataclasses.replace(capture, camera_from_world=moved(capture.camera_from_world, offset_m))
