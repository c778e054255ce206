"""World frame (ENU: x east, y north, z up, metres), camera frames and similarity transforms.

Transforms read ``target_from_source``. Camera axes are OpenCV's: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.config import CameraConfig
from nbv.types import Floats, Point


def intrinsic_matrix(camera: CameraConfig) -> Floats:
    """(3, 3) K; principal point in the image centre, pixel centres at half-integers (COLMAP)."""
    return np.array(
        [
            [camera.focal_px, 0.0, camera.width_px / 2.0],
            [0.0, camera.focal_px, camera.height_px / 2.0],
            [0.0, 0.0, 1.0],
        ]
    )


def look_at(position_m: Floats, target_m: Floats) -> Floats:
    """(4, 4) ``camera_from_world`` of a zero-roll camera at ``position_m`` aimed at ``target_m``.

    Straight down or up, where zero roll is undefined, the image's up is north.
    """
    position = np.asarray(position_m, dtype=float)
    forward = np.asarray(target_m, dtype=float) - position
    norm = np.linalg.norm(forward)
    if norm < 1e-12:
        raise ValueError("look_at: the camera is at its target")
    forward /= norm
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-9:
        right = np.cross(forward, (0.0, 1.0, 0.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    rotation = np.stack([right, down, forward])
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = -rotation @ position
    return transform


def camera_centers_m(camera_from_world: Floats) -> Floats:
    """(..., 3) camera centres of rigid transforms (..., 4, 4)."""
    rotation, translation = camera_from_world[..., :3, :3], camera_from_world[..., :3, 3]
    if camera_from_world.ndim == 2:
        return -rotation.T @ translation  # its last bits are not einsum's, and earlier missions have them
    return -np.einsum("...ji,...j->...i", rotation, translation)


def directions_from(origins_m: Floats | Point, places_m: Floats) -> Floats:
    """(..., 3) unit vectors from one place, or from one each, to places (..., 3)."""
    delta = places_m - origins_m
    return delta / np.linalg.norm(delta, axis=-1, keepdims=True)


def angle_deg(a: Floats, b: Floats) -> float:
    """Angle between two directions (3,), such as those from the target to two cameras."""
    cosine = a @ b / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def angles_deg(a: Floats, b: Floats) -> Floats:
    """(A, B) angles between unit vectors (A, 3) and (B, 3)."""
    angles: Floats = np.rad2deg(np.arccos(np.clip(a @ b.T, -1.0, 1.0)))
    return angles


def azimuths_elevations_deg(directions: Floats) -> tuple[Floats, Floats]:
    """(N,) azimuths, counter-clockwise from east and 0 to 360, and (N,) elevations of directions (N, 3)."""
    azimuths = np.rad2deg(np.arctan2(directions[:, 1], directions[:, 0])) % 360.0
    sines = directions[:, 2] / np.linalg.norm(directions, axis=1)
    return azimuths, np.rad2deg(np.arcsin(np.clip(sines, -1.0, 1.0)))


def unit_vectors(azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
    """(N, 3) directions with these azimuths, counter-clockwise from east, and elevations (N,)."""
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    return np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def invert_rigid(b_from_a: Floats) -> Floats:
    """(4, 4) ``a_from_b``."""
    out = np.eye(4)
    out[:3, :3] = b_from_a[:3, :3].T
    out[:3, 3] = -b_from_a[:3, :3].T @ b_from_a[:3, 3]
    return out


def rotation_angles_deg(rotations: Floats) -> Floats:
    """(...) angles of rotations (..., 3, 3)."""
    cosines = (np.trace(rotations, axis1=-2, axis2=-1) - 1.0) / 2.0
    return np.rad2deg(np.arccos(np.clip(cosines, -1.0, 1.0)))


def heading_to(position_m: Floats, target_m: Floats) -> Floats:
    """Heading (rad, counter-clockwise from east) from each position (..., 3) towards the target."""
    delta = np.asarray(target_m, dtype=float) - np.asarray(position_m, dtype=float)
    return np.arctan2(delta[..., 1], delta[..., 0])


def wrap_angle(angle_rad: Floats | float) -> Floats:
    """The same angle in [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True)
class Similarity:
    """``target = scale * rotation @ source + translation``."""

    scale: float
    rotation: Floats  # (3, 3)
    translation: Floats  # (3,)

    @property
    def turn_deg(self) -> float:
        """Angle of the rotation."""
        return float(rotation_angles_deg(self.rotation))

    def apply(self, points: Floats) -> Floats:
        """(..., 3) points of the source frame in the target frame."""
        return self.scale * np.asarray(points) @ self.rotation.T + self.translation

    def after(self, first: Similarity) -> Similarity:
        """The similarity that applies ``first``, then this one."""
        return Similarity(
            self.scale * first.scale, self.rotation @ first.rotation, self.apply(first.translation)
        )


def align_umeyama(target: Floats, source: Floats) -> Similarity:
    """Least-squares similarity ``target_from_source`` of paired points (N, 3), N >= 3.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    PAMI 1991, with the reflection guard.
    """
    target, source = np.asarray(target, dtype=float), np.asarray(source, dtype=float)
    if target.shape != source.shape or target.ndim != 2 or target.shape[0] < 3:
        raise ValueError(f"align_umeyama needs two (N >= 3, 3) arrays, got {target.shape} and {source.shape}")
    mean_target, mean_source = target.mean(0), source.mean(0)
    y, x = target - mean_target, source - mean_source
    u, singular, vt = np.linalg.svd(y.T @ x / len(x))
    sign = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        sign[2] = -1.0
    rotation = (u * sign) @ vt
    variance = (x**2).sum() / len(x)
    if variance < 1e-18:
        raise ValueError("align_umeyama: the source points coincide")
    scale = float((singular * sign).sum() / variance)
    return Similarity(scale, rotation, mean_target - scale * rotation @ mean_source)
