"""Verified matches of neighbours, by the angle between them: photographs of sets against rendered ones, 640 px wide or high.

python -m research.photographs.matches slab slab@indoors mictlan sand
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from nbv.cache import Store
from nbv.config import IDEAL, CameraConfig, MissionConfig, load_condition, preset, under
from nbv.dense.views import shrunk, shrunk_camera
from nbv.geometry.frames import look_at
from nbv.photographs import PhotographSet
from nbv.rocks import Rock, load_rock
from nbv.rocks.catalogue import is_photographed
from nbv.scene import Sensor, build_scene, make_renderer
from nbv.sparse.features import extract_features
from nbv.sparse.matching import match_pair, pair_angle_deg, verify_pair
from nbv.types import Floats
from nbv.viewpoints import seed_viewpoints

WANTED_DEG = {15: (12.0, 18.0), 30: (26.0, 34.0)}
VIEWS = 24
SIZE_PX = 640
PAIRS = 16  # of each kind, at most


def rendered(rock: Rock, config: MissionConfig) -> tuple[Floats, list[np.ndarray]]:
    """A ring at 22 degrees."""
    sensor = Sensor(config)
    renderer = make_renderer(
        build_scene(rock, config.scene, sensor.drawn, store=Store()), config.scene.backend
    )
    ring = config.with_values({"seed.count": VIEWS, "seed.lowest_deg": 22.0, "seed.radius_m": 3.5})
    at = np.array([v.position_m for v in seed_viewpoints(ring)])
    poses = [look_at(p, np.array(config.target_m)) for p in at]
    return at, [sensor.photograph(renderer, pose, (rock.sha256, 0, f"{k}")) for k, pose in enumerate(poses)]


def taken(photographs: PhotographSet, camera: CameraConfig) -> tuple[Floats, list[np.ndarray]]:
    """Every few of them, in the order in which they were taken, at the size of ``camera``."""
    chosen = photographs.registered[:: max(1, len(photographs.registered) // (2 * VIEWS))]
    at = np.array([p.camera_center_m for p in chosen])
    return at, [shrunk(photographs.image(p.name), camera) for p in chosen]


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
    for asked in sys.argv[1:]:
        print(asked)
        name, _, condition = asked.partition("@")
        config = under(preset("campaign"), load_condition(condition or IDEAL))
        if is_photographed(name):
            photographs = PhotographSet.read(name)
            camera = shrunk_camera(photographs.camera, SIZE_PX)
            found = counts(*taken(photographs, camera), photographs.target_m, camera, config)
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
