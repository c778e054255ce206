"""What the limits of agreement do to SGBM's clouds: ours, 0.5 % of depth and 1 px, against COLMAP's, 1 % and 2 px.

    OMP_NUM_THREADS=1 python -m research.sgbm_limits --out limits.csv

Missions of `make tune` (20 photographs, `indoors`) on the training rocks, by Hyb-H and on a plain orbit. Photographs, sparse
model and depth maps of a mission are made once; its cloud is checked, fused and measured with each limit. Prints the means
over rocks and the least of the rocks' gains. Goes on where the file ends.
"""

from __future__ import annotations

import argparse
import csv
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from nbv.config import load_condition, preset, under
from nbv.dense.consistency import check_consistency
from nbv.dense.fusion import fuse
from nbv.dense.stereo import sgbm_depth_maps
from nbv.dense.views import PosedViews
from nbv.evaluation import evaluate_cloud
from nbv.mission.function import no_log
from nbv.photogrammetric.photogrammetric_fidelity import PhotogrammetricFidelity
from nbv.stopwatch import Stopwatch
from tuner.campaign.settings_file import QUICK
from tuner.problem.baselines import BASELINES

ROCKS = ("boulder", "slab", "vesicular", "waist", "breccia", "cavern")
PLANS = ("hyb-h", "orbit")
LIMITS = {"ours": (0.005, 1.0), "colmap": (0.01, 2.0)}
PAIR_ANGLES_DEG = (35.0, 45.0)  # the largest of a stereo pair
AGREEING = (3, 6)
METRICS = tuple(f"{kind}_{mm}mm" for mm in (48, 16) for kind in ("f_score", "accuracy", "completeness"))
HEAD = ("plan", "rock", "pair_angle_deg", "agreeing", "limits", *METRICS)


class _Posed(Exception):
    """Ends a mission where its dense stage would begin."""

    def __init__(self, views: PosedViews) -> None:
        super().__init__()
        self.views = views


def rows_of(plan: str, rock: str) -> Iterator[dict[str, Any]]:
    """One mission with every pair angle, agreement and limit."""
    base = under(preset("campaign"), load_condition("indoors")).with_values(QUICK["overrides"])
    config = BASELINES[plan].config(base)
    context = PhotogrammetricFidelity.prepare(config, rock, 0, None, False, Stopwatch())

    def end(views: PosedViews, _: Any) -> None:
        raise _Posed(views)

    with patch("nbv.photogrammetric.reconstructor.dense_cloud", end):
        try:
            PhotogrammetricFidelity(context).mission(None, None, no_log).run()
        except _Posed as posed:
            views = posed.views
    for angle_deg in PAIR_ANGLES_DEG:
        views = replace(views, config=replace(views.config, max_pair_angle_deg=angle_deg))
        maps = sgbm_depth_maps(views)
        for agreeing, (limits, (relative, px)) in itertools.product(AGREEING, LIMITS.items()):
            change = {"consistency_relative_depth": relative, "consistency_px": px}
            variant = replace(views, config=replace(views.config, agreeing_views=agreeing, **change))
            cloud = fuse(check_consistency(maps, variant), variant)
            found = evaluate_cloud(cloud, context.rock, config).metrics["registered"]["observable"]
            yield dict(zip(HEAD, (plan, rock, angle_deg, agreeing, limits), strict=False)) | {
                name: round(found[name], 3) for name in METRICS
            }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rocks", nargs="+", default=ROCKS)
    asked = parser.parse_args()
    rows = list(csv.DictReader(asked.out.open())) if asked.out.exists() else []
    for rock, plan in itertools.product(asked.rocks, PLANS):
        if not any(row["rock"] == rock and row["plan"] == plan for row in rows):
            rows += rows_of(plan, rock)
            with asked.out.open("w", newline="") as file:
                writer = csv.DictWriter(file, HEAD, lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
    print("|plan|agree|pairs to|limits|" + "|".join(METRICS) + "|")
    for plan, agreeing, angle_deg, limits in itertools.product(PLANS, AGREEING, PAIR_ANGLES_DEG, LIMITS):
        wanted = (plan, str(agreeing), str(angle_deg), limits)
        chosen = [
            row
            for row in rows
            if tuple(str(row[k]) for k in ("plan", "agreeing", "pair_angle_deg", "limits")) == wanted
        ]
        means = (f"{np.mean([float(row[name]) for row in chosen]):.2f}" for name in METRICS)
        print(f"|{plan}|{agreeing}|{angle_deg:g}|{limits}|" + "|".join(means) + "|")


if __name__ == "__main__":
    main()
