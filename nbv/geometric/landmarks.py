"""The simulator's landmarks: how easily each is detected and matched, and which of them a view detects.

Everything is drawn per (rock, replicate) and per (rock, replicate, viewpoint), so it is the same in every mission on
them. It is kept with the rock's world: a campaign comes back to the same few hundred viewpoints.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from nbv.geometric.world import GeometricWorld
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Floats32, Ints

_MAX_KEPT = 32  # draws per world
_MAX_LOOKS = 512  # per draw; some 10 kB each

Look = tuple[Ints, Floats32]


@dataclass(frozen=True)
class FeatureModel:
    """Free constants of detection and matching, set to reproduce real seed models (see the benchmark)."""

    rock_rate: float = 0.7  # share of views in which a strong, well-lit landmark is detected
    ground_rate: float = 0.9
    half_contrast: float = 0.012  # at this local contrast it is half of that
    incidence_power: float = 1.0  # how fast detection falls towards grazing views
    max_incidence_deg: float = 75.0
    far_max_incidence_deg: float = 86.0  # flat ground far away is only ever seen at a grazing angle
    rock_match_deg: tuple[float, float] = (12.0, 45.0)  # lines of sight that match: drawn per landmark
    ground_match_deg: tuple[float, float] = (15.0, 125.0)  # flat, so it looks alike from farther
    min_track_length: int = 3
    noise_px: float = 0.5


@dataclass(frozen=True)
class Draw:
    """What the landmarks of a world depend on."""

    count: int  # L: the world's first so many
    features: FeatureModel
    max_pair_angle_deg: float
    rock_sha256: str
    replicate: int
    ground_from_above: bool = False  # ground features: the ground looks alike from everywhere


@dataclass(frozen=True)
class Landmarks:
    """The draws of one (rock, replicate) for the world's first L landmarks, and what its viewpoints detect."""

    world: GeometricWorld
    draw: Draw
    quality: Floats  # (L,) chance of a detection face on
    cosine_limit: Floats  # (L,) of the angle between two lines of sight that still match
    grazing: Floats  # (L,) cosine of the incidence beyond which nothing is detected
    noise: Floats  # (L, 3) of the point's position, standard normal
    error_px: Floats  # (L,) reprojection error
    _looks: dict[tuple[str, bytes], Look] = field(default_factory=dict, repr=False)

    def look(self, viewpoint_id: str, center_m: Floats) -> Look:
        """The landmarks (K,) that a view from ``center_m`` (3,) detects, and unit directions (K, 3) to it."""
        key = (viewpoint_id, center_m.tobytes())
        look = self._looks.get(key)
        if look is None:
            while len(self._looks) >= _MAX_LOOKS:
                self._looks.pop(next(iter(self._looks)))
            look = self._looks[key] = self._look(viewpoint_id, center_m)
        return look

    def _look(self, viewpoint_id: str, center_m: Floats) -> Look:
        world = self.world
        seen = np.flatnonzero(world.landmark_seen[world.index(viewpoint_id), : len(self.quality)])
        directions = center_m - world.landmarks_m[seen]
        directions /= np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
        cosine = np.einsum("ij,ij->i", directions, world.landmark_normals[seen])
        grazing = self.grazing[seen]
        facing = np.clip((cosine - grazing) / (1.0 - grazing), 0.0, 1.0)
        chance = self.quality[seen] * facing**self.draw.features.incidence_power
        rng = keyed_rng("geometric-detection", self.draw.rock_sha256, self.draw.replicate, viewpoint_id)
        detected = rng.random(len(self.quality))[seen] < chance
        return seen[detected], directions[detected].astype(np.float32)


def landmarks_of(world: GeometricWorld, draw: Draw) -> Landmarks:
    """The landmarks as drawn, made once per world."""
    kept: dict[Draw, Landmarks] = world.memory
    landmarks = kept.get(draw)
    if landmarks is None:
        while len(kept) >= _MAX_KEPT:
            kept.pop(next(iter(kept)))
        landmarks = kept[draw] = _drawn(world, draw)
    return landmarks


def _drawn(world: GeometricWorld, draw: Draw) -> Landmarks:
    n, features = draw.count, draw.features
    rng = keyed_rng("geometric-landmarks", draw.rock_sha256, draw.replicate)
    strength, reach = rng.random((n, 2)).T  # row by row, so a landmark's draw does not depend on n
    rng = keyed_rng("geometric-noise", draw.rock_sha256, draw.replicate)
    noise = rng.standard_normal((n, 4))
    on_rock = np.arange(n) < world.n_rock
    # The ground's landmarks are a thinned lattice of its strongest features: all are worth something.
    rate = np.where(on_rock, features.rock_rate * 2.0 * strength, features.ground_rate)
    contrast = world.landmark_contrast[:n]
    low = np.where(on_rock, features.rock_match_deg[0], features.ground_match_deg[0])
    high = np.where(on_rock, features.rock_match_deg[1], features.ground_match_deg[1])
    limit_deg = low + (high - low) * reach**2
    if draw.ground_from_above:
        limit_deg = np.where(on_rock, limit_deg, 180.0)
    limit_deg = np.minimum(limit_deg, draw.max_pair_angle_deg)
    far = np.arange(n) >= world.n_near
    return Landmarks(
        world=world,
        draw=draw,
        quality=np.minimum(rate, 1.0) * contrast / (contrast + features.half_contrast),
        cosine_limit=np.cos(np.deg2rad(limit_deg)),
        grazing=np.cos(np.deg2rad(np.where(far, features.far_max_incidence_deg, features.max_incidence_deg))),
        noise=noise[:, :3],
        error_px=0.28 * np.exp(0.8 * noise[:, 3]),
    )
