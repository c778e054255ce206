"""How far a mission's completeness and F-score scatter over the draw of the true surface's samples.

    OMP_NUM_THREADS=1 python -m research.ground_truth_sampling ROCK RUN [ROCK RUN ...]

RUN: directory of a mission on ROCK that was flown with everything kept (``gatetune mission run``). Its cleaned cloud
is measured at 48 mm on the observable surface against uniform samples and against the stratified ones of the
evaluation, one seed after another. Prints CSV; the smallest difference that is claimed is 0.5 points.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import open3d as o3d
import yaml

from nbv.cache import Store
from nbv.config import config_from_dict
from nbv.evaluation.evaluate import camera_shell
from nbv.evaluation.ground_truth import build_ground_truth
from nbv.evaluation.measures import f_score
from nbv.geometry.neighbours import nearest_neighbours
from nbv.geometry.raycasting import RayCaster
from nbv.geometry.sampling import sample_surface, sample_surface_evenly
from nbv.rocks import load_rock

SAMPLERS = {"uniform": sample_surface, "stratified": sample_surface_evenly}
SEEDS = 10
COUNTS = (50_000, 200_000)
LABELS = 300_000  # samples whose visibility is worked out once; others take that of the nearest
THRESHOLD_M = 0.048


def main(arguments: list[str]) -> None:
    print("rock,samples,sampler,seeds,completeness_mean,completeness_sd,f_score_sd")
    for name, run in zip(arguments[::2], arguments[1::2], strict=True):
        config = config_from_dict(yaml.safe_load((Path(run) / "config.yaml").read_text()))
        rock = load_rock(name, Store())
        cloud = np.asarray(o3d.io.read_point_cloud(str(Path(run) / "cleaned.ply")).points)
        right = RayCaster(rock.vertices_m, rock.faces).distances_m(cloud) < THRESHOLD_M
        labels = build_ground_truth(rock.vertices_m, rock.faces, camera_shell(config), LABELS)
        for count in COUNTS:
            for kind, sample in SAMPLERS.items():
                scores = []
                for seed in range(SEEDS):
                    points = sample(rock.vertices_m, rock.faces, count, seed)[0]
                    seen = labels.observable[nearest_neighbours(labels.points_m, points)[1]]
                    near = nearest_neighbours(cloud, points[seen], within_m=THRESHOLD_M)[0] < THRESHOLD_M
                    complete = 100.0 * float(near.mean())
                    scores.append((complete, f_score(100.0 * float(right.mean()), complete)))
                sd = np.std(scores, axis=0, ddof=1)
                mean = np.mean([complete for complete, _ in scores])
                print(f"{rock.name},{count},{kind},{SEEDS},{mean:.3f},{sd[0]:.4f},{sd[1]:.4f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
