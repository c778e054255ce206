"""From where a set's photographs were taken, as seen from the object, and where nobody stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.photographs.photograph_set import PhotographSet
from nbv.types import Floats

WIDE_GAP_DEG = 30.0  # between neighbours in azimuth: a step that SIFT rarely bridges


@dataclass(frozen=True)
class Coverage:
    """Viewpoints of the registered photographs (M,), in their order, and the gaps between them."""

    names: tuple[str, ...]
    azimuths_deg: Floats  # counter-clockwise, 0 to 360
    elevations_deg: Floats
    distances_m: Floats  # from the object's centre
    gaps_deg: tuple[tuple[float, float], ...]  # azimuths between which nobody stood, widest first


def coverage(photographs: PhotographSet) -> Coverage:
    """Azimuth, elevation and distance of the registered photographs about the object's centre."""
    offsets = np.array([p.camera_center_m for p in photographs.registered]) - photographs.target_m
    distances = np.linalg.norm(offsets, axis=1)
    azimuths = np.rad2deg(np.arctan2(offsets[:, 1], offsets[:, 0])) % 360
    elevations = np.rad2deg(np.arcsin(np.clip(offsets[:, 2] / distances, -1, 1)))
    around = np.sort(azimuths)
    steps = np.diff(np.append(around, around[0] + 360))
    wide = [i for i in np.argsort(-steps) if steps[i] > WIDE_GAP_DEG]
    gaps = tuple((float(around[i]), float((around[i] + steps[i]) % 360)) for i in wide)
    names = tuple(p.name for p in photographs.registered)
    return Coverage(names, azimuths, elevations, distances, gaps)
