"""The simulator's landmarks: how easily each is detected and matched, and which of them a view detects.

Everything is drawn per (rock, replicate) and per (rock, replicate, viewpoint), so it is the same in every mission on
them. The constants were set to reproduce real seed models (docs/results/index.md).
"""

from __future__ import annotations

import numpy as np

from nbv.config import MissionConfig
from nbv.geometric.world import GeometricWorld, resolved
from nbv.random_streams import keyed_rng
from nbv.types import Floats, Floats32, Ints, Point, Viewpoint

ROCK_RATE = 0.7  # share of views in which a strong, well-lit landmark is detected
GROUND_RATE = 0.9
HALF_CONTRAST = 0.012  # at this local contrast it is half of that
# With 60 px of focal length neither these nor photogrammetric missions of slab have a seed model; with 120, 200 and 300 px these
# score 88, 91 and 95, those 74, 84 and 92 (F-score at 48 mm, 24 + 8 photographs).
RESOLVED = 0.4
MAX_INCIDENCE_DEG = 75.0
FAR_MAX_INCIDENCE_DEG = 86.0  # flat ground far away is only ever seen at a grazing angle
ROCK_MATCH_DEG = (12.0, 45.0)  # lines of sight that match: drawn per landmark
GROUND_MATCH_DEG = (15.0, 125.0)  # flat, so it looks alike from farther


class Landmarks:
    """The draws of one (rock, replicate) for a world's landmarks, L of them, and what its viewpoints detect.

    Of the configuration, far ground only matters where ``stop.knn_region`` is of all of the cloud; ground features let the ground
    look alike from everywhere.
    """

    def __init__(
        self, world: GeometricWorld, config: MissionConfig, rock_sha256: str, replicate: int
    ) -> None:
        self._world, self._key = world, (rock_sha256, replicate)
        self.count = n = len(world.landmarks_m) if config.stop.knn_region == "all" else world.n_near
        # Row by row, so a landmark's draw does not depend on n.
        strength, reach = keyed_rng("geometric-landmarks", *self._key).random((n, 2)).T
        noise = keyed_rng("geometric-noise", *self._key).standard_normal((n, 4))
        on_rock = np.arange(n) < world.n_rock
        # The ground's landmarks are a thinned lattice of its strongest features: all are worth something.
        rate = np.minimum(np.where(on_rock, ROCK_RATE * 2.0 * strength, GROUND_RATE), 1.0)
        contrast = world.landmark_contrast[:n]
        low, high = (np.where(on_rock, *both) for both in zip(ROCK_MATCH_DEG, GROUND_MATCH_DEG))
        limit_deg = low + (high - low) * reach**2
        if config.sparse.ground_features:
            limit_deg = np.where(on_rock, limit_deg, 180.0)
        limit_deg = np.minimum(limit_deg, min(config.sparse.max_pair_angle_deg, config.scene.match_angle_deg))
        far = np.arange(n) >= world.n_near
        # (L,) chance of a detection face on, and the cosine of the incidence beyond which nothing is detected.
        self._quality = rate * contrast / (contrast + HALF_CONTRAST)
        self._grazing = np.cos(np.deg2rad(np.where(far, FAR_MAX_INCIDENCE_DEG, MAX_INCIDENCE_DEG)))
        # (L,) the cosine of the angle between two lines of sight that still match.
        self.cosine_limit: Floats = np.cos(np.deg2rad(limit_deg))
        self.noise: Floats = noise[:, :3]  # (L, 3) of the point's position, standard normal
        self.error_px: Floats = 0.28 * np.exp(0.8 * noise[:, 3])  # (L,) reprojection error

    def detected_from(self, view: Viewpoint, aim_m: Point, center_m: Floats) -> tuple[Ints, Floats32]:
        """Indices (K,) of the landmarks that a photograph detects, and unit directions (K, 3) from them to the camera.

        ``aim_m``: where the camera is aimed; ``center_m`` (3,): where it really is, arrival error included.
        """
        world = self._world
        seen = np.flatnonzero(world.landmarks_seen(view.position_m, aim_m)[: self.count])
        directions = center_m - world.landmarks_m[seen]
        directions /= np.sqrt(np.einsum("ij,ij->i", directions, directions))[:, None]
        cosine = np.einsum("ij,ij->i", directions, world.landmark_normals[seen])
        grazing = self._grazing[seen]
        chance = self._quality[seen] * np.clip((cosine - grazing) / (1.0 - grazing), 0.0, 1.0)
        chance = resolved(chance, world.camera, RESOLVED)
        rng = keyed_rng("geometric-detection", *self._key, view.id)
        detected = rng.random(self.count)[seen] < chance
        return seen[detected], directions[detected].astype(np.float32)
