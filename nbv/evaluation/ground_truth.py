"""The reference surface: seeded samples of a mesh, and which of them any mission could have seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nbv.cache import Arrays, Store, cached
from nbv.config import MissionConfig
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface_evenly
from nbv.geometry.visibility import OBSERVABLE_MAX_INCIDENCE_DEG, SURFACE_OFFSET_M, seen_from
from nbv.rocks import Rock
from nbv.types import Bools, Floats, Ints
from nbv.viewpoints import camera_shell

MIN_OBSERVING_VIEWS = 2  # a depth needs two rays


@dataclass(frozen=True)
class GroundTruthSamples:
    """Samples of the whole reference surface and the part of it that the camera shell can reach: elsewhere no planner can win or lose."""

    points_m: Floats  # (S, 3) world frame
    observable: Bools  # (S,)


def ground_truth(rock: Rock, config: MissionConfig, store: Store | None = None) -> GroundTruthSamples:
    """Samples of the true surface and the part that the camera shell can see; kept in ``store``."""
    shell, count = camera_shell(config), config.evaluation.gt_samples

    def make() -> Arrays:
        points, normals = sample_surface_evenly(rock.vertices_m, rock.faces, count, 0)
        caster = RayCaster(rock.vertices_m, rock.faces)
        return {"points_m": points, "observable": observable_mask(caster, points, normals, shell)}

    arrays = cached(store, "ground-truth", make, code=__name__, inputs=[rock.sha256, shell, count])
    return GroundTruthSamples(**arrays)


def observable_mask(caster: RayCaster, points_m: Floats, normals: Floats, camera_centers_m: Floats) -> Bools:
    """(S,) which of points (S, 3) with unit outward normals (S, 3) at least two of the reachable cameras (C, 3) see.

    A camera sees a sample that lies above the ground (z = 0), faces the camera with an incidence of at most 80 degrees,
    and is not hidden by the mesh (`nbv.geometry.visibility`). Image borders are ignored: cameras aim at the target and
    the rock fits the frame. With sample and camera above the ground, the ground plane cannot occlude.
    """
    starts = points_m + SURFACE_OFFSET_M * normals
    views = np.zeros(len(points_m), dtype=np.int64)
    open_samples: Ints = np.flatnonzero(points_m[:, 2] > 0)
    # Shuffled, since neighbours on a ring see the same samples: the first few then settle most of these. The result does
    # not depend on the order.
    for center in np.random.default_rng(0).permutation(camera_centers_m):
        if open_samples.size == 0:
            break
        facing = normals[open_samples]
        seen = seen_from(center, starts[open_samples], facing, caster, OBSERVABLE_MAX_INCIDENCE_DEG)
        views[open_samples[seen]] += 1
        open_samples = open_samples[views[open_samples] < MIN_OBSERVING_VIEWS]
    return views >= MIN_OBSERVING_VIEWS
