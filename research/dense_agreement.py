"""How many views must agree on a depth: scores of the SGBM dense stage at the true poses.

    OMP_NUM_THREADS=1 python -m research.dense_agreement [ROCK ...] [--mesh FILE] [--extra 0 8 16]

For each rock (catalogue names, or a mesh file): photographs of the 24 seed viewpoints and of the first
EXTRA candidates of one seeded shuffle of the pool, depth maps, then consistency, fusion, cleaning and
metrics for 2 to 5 agreeing views. Prints a Markdown table; C, A, F are completeness, accuracy and
F-score in percent on the observable surface, at 48 and 16 mm. Seconds are CPU seconds.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.dense.consistency import check_consistency
from nbv.dense.fusion import fuse
from nbv.dense.sgbm import SgbmBackend
from nbv.evaluation import evaluate_cloud
from nbv.geometry.frames import look_at
from nbv.random_streams import keyed_rng
from nbv.rocks import Rock, import_mesh, load_rock
from nbv.scene import Sensor, build_scene, make_renderer
from nbv.viewpoints import raw_candidates, seed_viewpoints


def measure(rock: Rock, extras: list[int], config: MissionConfig) -> None:
    """Print the table rows of one rock."""
    sensor = Sensor(config)
    renderer = make_renderer(
        build_scene(rock, config.scene, sensor.drawn, store=Store()), config.scene.backend
    )
    seeds, pool = list(seed_viewpoints(config)), list(raw_candidates(config))
    shuffled = [pool[i] for i in keyed_rng("dense agreement", rock.sha256).permutation(len(pool))]
    views = [*seeds, *shuffled[: max(extras)]]
    poses = {v.id: look_at(np.array(v.position_m), np.array(config.target_m)) for v in views}
    images = {v.id: sensor.photograph(renderer, poses[v.id], rock, 0, v.id) for v in views}
    for extra in extras:
        names = [v.id for v in views[: len(seeds) + extra]]
        chosen_images = {name: images[name] for name in names}
        chosen_poses = {name: poses[name] for name in names}
        start = time.process_time()
        maps = SgbmBackend().depth_maps(
            chosen_images, chosen_poses, config.camera, config.target_m, config.dense
        )
        depth_s = time.process_time() - start
        for agreeing in (2, 3, 4, 5):
            dense = dataclasses.replace(config.dense, agreeing_views=agreeing)
            start = time.process_time()
            checked = check_consistency(maps, chosen_poses, config.camera, config.target_m, dense)
            depths = {name: item.depth_m for name, item in checked.items()}
            cloud = fuse(depths, chosen_images, chosen_poses, config.camera, config.target_m, dense)
            fusion_s = time.process_time() - start
            start = time.process_time()
            scores = evaluate_cloud(cloud, rock, config, Store()).metrics
            evaluation_s = time.process_time() - start
            part = scores["observable"]
            values = [
                part[f"{kind}_{t}mm"] for t in (48, 16) for kind in ("completeness", "accuracy", "f_score")
            ]
            print(
                f"| {rock.name} | {len(seeds)} + {extra} | {agreeing} | "
                + " | ".join(f"{value:.1f}" for value in values)
                + f" | {scores['n_points']} | {depth_s:.1f} | {fusion_s:.1f} | {evaluation_s:.1f} |",
                flush=True,
            )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("rocks", nargs="*", help="catalogue names")
    parser.add_argument("--mesh", type=Path, nargs="*", default=[], help="mesh files, scaled to 1.6 m")
    parser.add_argument("--extra", type=int, nargs="+", default=[0, 8, 16], help="candidates after the seeds")
    arguments = parser.parse_args()
    rocks = [load_rock(name, Store()) for name in arguments.rocks] + [
        import_mesh(path) for path in arguments.mesh
    ]
    print(
        "| rock | views | agreeing | C48 | A48 | F48 | C16 | A16 | F16 | points | depth s | fusion s "
        "| cleaning and metrics s |\n" + "|---" * 13 + "|"
    )
    for rock in rocks or [load_rock("boulder", Store())]:
        measure(rock, sorted(arguments.extra), MissionConfig())


if __name__ == "__main__":
    main()
