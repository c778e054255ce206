"""What a perfect reconstruction of everything observable would get, rock by rock.

    OMP_NUM_THREADS=1 python -m research.hausdorff_floor [ROCK ...]

Rocks are catalogue names or mesh files; without any, the procedural training rocks. Preset ``campaign``. Prints
the floors that missions hold beside their Hausdorff distances (``nbv/evaluation/floor.py``), the share of
the surface that no two reachable cameras see, and the best completeness at 48 mm of the whole surface.
"""

from __future__ import annotations

import sys

from nbv.cache import Store
from nbv.config import preset
from nbv.evaluation import ground_truth
from nbv.evaluation.floor import perfect_cloud, rock_floors
from nbv.geometry.neighbours import nearest_neighbours
from nbv.rocks import list_rocks, load_rock


def main() -> None:
    config = preset("campaign")
    names = sys.argv[1:] or [r.name for r in list_rocks() if r.split == "train" and r.source == "procedural"]
    print(
        "| rock | never visible (% of the surface) | floor, whole (mm) | floor, observable (mm) | floor, cloud to "
        "truth (mm) | best completeness @ 48 mm, whole (%) |\n|---|---:|---:|---:|---:|---:|"
    )
    for name in names:
        rock = load_rock(name, Store())
        truth = ground_truth(rock, config, Store())
        floors = rock_floors(rock, truth, config, Store())
        cloud = perfect_cloud(rock, config)
        reached = nearest_neighbours(cloud, truth.points_m)[0] < 0.048
        key = "hausdorff_gt_to_cloud_floor_mm"
        print(
            f"| {rock.name} | {100 * (~truth.observable).mean():.1f} | {floors['whole'][key]:.0f} | "
            f"{floors['observable'][key]:.0f} | {floors['whole']['hausdorff_cloud_to_gt_floor_mm']:.1f} | "
            f"{100 * reached.mean():.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
