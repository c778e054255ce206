"""What the dense stage does to the score: reference poses, every few of the photographs, and sizes and agreements to try.

python -m research.photographs.dense_variants sand --every 2 1280,6 640,6 480,6 480,3
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
import pycolmap

from nbv.config import preset
from nbv.config.presets import REDUCED_SFM
from nbv.dense import PosedViews, dense_cloud
from nbv.photographs import PhotographSet
from nbv.photographs.evaluation import MARGIN, measure_cloud
from nbv.photographs.mission import config_for_set
from nbv.photographs.photograph_set import SPARSE


def main() -> None:
    """A line per variant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set")
    parser.add_argument("variants", nargs="+", help="long side in pixels, views that must agree")
    parser.add_argument("--every", type=int, default=1)
    asked = parser.parse_args()
    photographs = PhotographSet.read(asked.set)
    reference = photographs.reference()
    config = config_for_set(preset("campaign").with_values(REDUCED_SFM), photographs)
    taken = sorted(photographs.registered, key=lambda p: p.name)[:: asked.every]
    images = {p.name: photographs.image(p.name) for p in taken}
    poses = {p.name: p.camera_from_world for p in taken if p.camera_from_world is not None}
    model = pycolmap.Reconstruction(photographs.folder / SPARSE)
    points_m = np.array([point.xyz for point in model.points3D.values()])
    half_m = np.array(photographs.extents_m) / 2 + MARGIN * photographs.height_m
    points_m = points_m[(np.abs(points_m - photographs.target_m) <= half_m).all(axis=1)]
    for variant in asked.variants:
        size_px, agreeing = map(int, variant.split(","))
        dense = replace(config.dense, max_size_px=size_px, agreeing_views=agreeing)
        began = time.process_time()
        posed = PosedViews(images, poses, photographs.camera, photographs.target_m, dense)
        cloud = dense_cloud(posed, points_m)
        seconds = time.process_time() - began
        found = measure_cloud(cloud, photographs, reference, config.evaluation)[0]["observable"]
        scores = ", ".join(
            f"{key} {found[key]:.1f}" for key in ("f_score_48mm", "completeness_48mm", "accuracy_48mm")
        )
        print(f"{len(images)} photographs, {size_px} px, {agreeing} agree: {scores}; {seconds:.1f} CPU s")


if __name__ == "__main__":
    main()
