"""Verified matches of neighbours, by the angle between them: photographs of sets against rendered ones.

python -m research.photographs.matches slab vesicular mictlan sand
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from nbv.cache import Store
from nbv.config import CameraConfig, MissionConfig, preset
from nbv.geometry import look_at
from nbv.photographs import PhotographSet
from nbv.rocks import Rock, load_rock
from nbv.rocks.imported import is_photographed
from nbv.scene import build_scene, make_renderer
from nbv.sparse.features import extract_features
from nbv.sparse.matching import match_pair, pair_angle_deg, verify_pair
from nbv.types import Floats
from nbv.viewpoints import seed_viewpoints

WANTED_DEG = {15: (12.0, 18.0), 30: (26.0, 34.0)}
VIEWS = 24
PAIRS = 16  # of each kind, at most


def rendered(rock: Rock, config: MissionConfig) -> tuple[Floats, list[np.ndarray]]:
    """A ring at 22 degrees."""
    renderer = make_renderer(
        build_scene(rock, config.scene, config.camera, store=Store()), config.scene.backend
    )
    ring = config.with_values({"seed.count": VIEWS, "seed.lowest_deg": 22.0, "seed.radius_m": 3.5})
    at = np.array([v.position_m for v in seed_viewpoints(ring)])
    return at, [renderer.rgb(look_at(p, np.array(config.target_m))) for p in at]


def taken(photographs: PhotographSet) -> tuple[Floats, list[np.ndarray]]:
    """Every few of them, in the order in which they were taken."""
    chosen = photographs.registered[:: max(1, len(photographs.registered) // (2 * VIEWS))]
    at = np.array([p.camera_center_m for p in chosen])
    return at, [photographs.image(p.name) for p in chosen]


def counts(
    at: Floats,
    images: Sequence[np.ndarray],
    target_m: Sequence[float],
    camera: CameraConfig,
    config: MissionConfig,
) -> dict[int, list[int]]:
    """Verified matches of pairs about so many degrees apart."""
    features = [extract_features(image, config.sparse) for image in images]
    found: dict[int, list[int]] = {angle: [] for angle in WANTED_DEG}
    for a in range(len(at)):
        for b in range(a + 1, len(at)):
            angle = pair_angle_deg(at[a], at[b], np.asarray(target_m))
            for wanted, (low, high) in WANTED_DEG.items():
                if low <= angle <= high and len(found[wanted]) < PAIRS:
                    matches = match_pair(features[a].descriptors, features[b].descriptors)
                    found[wanted].append(
                        len(verify_pair(features[a], features[b], matches, camera, config.sparse))
                    )
    print("  features of a photograph, median:", int(np.median([len(f) for f in features])))
    return found


def main() -> None:
    """A line per rock or set."""
    config = preset("campaign")
    for name in sys.argv[1:]:
        print(name)
        if is_photographed(name):
            photographs = PhotographSet.read(name)
            found = counts(*taken(photographs), photographs.target_m, photographs.camera, config)
        else:
            found = counts(
                *rendered(load_rock(name, Store()), config), config.target_m, config.camera, config
            )
        for angle, values in found.items():
            share = 100 * np.mean(np.array(values) >= config.sparse.min_inliers) if values else float("nan")
            print(
                f"  {angle} degrees: median {np.median(values):.0f} of {len(values)} pairs, {share:.0f} % verified"
            )


if __name__ == "__main__":
    main()
