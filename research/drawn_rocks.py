"""Where real rocks lie among those that are drawn from families.

    python -m research.drawn_rocks --real ../shared/rocks --seeds 8 --out docs/results/data/drawn_rocks.csv
    python -m research.drawn_rocks --orbits --first 1000 --seeds 10 --out docs/results/data/drawn_orbits.csv

Of every rock: height, concavity (the share of its convex hull that it leaves empty), contrast of the albedo (standard
deviation over mean), and how hard it is: the F-score that a plain orbit of 20 photographs is predicted to reach (geometric
mission, 3 agreeing views, replicate 0). Real rocks are those of a folder, one mesh in each of its folders, at 1.6 m as they
are imported; without the folder they are skipped. ``--orbits``: the F-score that plain orbits of 16 to 52 photographs reach
on drawn rocks, on one ring at 10 degrees and on two, 38 % of them at 35 degrees; -1: the mission failed.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from nbv.config import MissionConfig, preset
from nbv.geometric import run_geometric_mission
from nbv.rocks import Rock, describe, load_coarse_rock
from nbv.rocks.families import FAMILIES
from nbv.rocks.mesh import signed_volume

ORBIT = {
    "dense.agreeing_views": 3,
    "sparse.ground_features": 2000,
    "sparse.min_registered_seeds": 6,
    "seed.count": 20,
    "seed.rings": 1,
    "seed.lowest_deg": 10.0,
    "seed.radius_m": 3.5,
    "stop.adaptive_budget": 0,
}
NUMBERS = (16, 20, 24, 28, 32, 40, 52)
TWO_RINGS = {"seed.span_deg": 25.0, "seed.upper_share": 0.38}
COLUMNS = ("rock", "kind", "height_m", "concavity", "albedo_contrast", "f_score_of_20")


def concavity(rock: Rock) -> float:
    """The share of the convex hull that the rock leaves empty, 0 to 1; small holes are closed towards the centroid."""
    return 1.0 - signed_volume(rock.vertices_m, rock.faces) / float(ConvexHull(rock.vertices_m).volume)


def row(name: str, kind: str, shown: str, config: MissionConfig) -> list[object]:
    """One line of the table."""
    rock = load_coarse_rock(name)
    evaluated = run_geometric_mission(config, name, cache=False)
    score = 0.0 if evaluated.status == "failed" else evaluated.metric("observable.f_score_48mm")
    height_m = float(np.ptp(rock.vertices_m[:, 2]))
    numbers = (height_m, concavity(rock), describe(rock).albedo_contrast, score)
    return [shown, kind, *(f"{number:.3f}" for number in numbers)]


def orbits(name: str) -> list[object]:
    """One line of the table of ``--orbits``."""
    found: list[object] = [name]
    for number in NUMBERS:
        for rings in ({}, TWO_RINGS):
            config = preset("campaign").with_values({**ORBIT, **rings, "seed.count": number})
            evaluated = run_geometric_mission(config, name, cache=False)
            score = -1.0 if evaluated.status == "failed" else evaluated.metric("observable.f_score_48mm")
            found.append(f"{score:.2f}")
    return found


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--real", type=Path, help="folder of folders with one mesh each")
    parser.add_argument("--seeds", type=int, default=8, help="how many training seeds of every family")
    parser.add_argument("--out", type=Path, required=True, help="CSV file")
    parser.add_argument("--first", type=int, default=0, help="the first of them")
    parser.add_argument("--orbits", action="store_true", help="plain orbits of many sizes instead")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    config = preset("campaign").with_values(ORBIT)
    places = [(f"{family}-{seed}", family, f"{family}-{seed}") for family in FAMILIES for seed in seeds]
    if given.orbits:
        with given.out.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["rock", *(f"{rings}{n}" for n in NUMBERS for rings in ("one", "two"))])
            table.writerows(orbits(name) for name, *_ in places)
        return
    if given.real is not None and given.real.is_dir():
        meshes = sorted(p for p in given.real.glob("*/*") if p.suffix in (".obj", ".ply", ".glb"))
        places += [(str(mesh), "real", mesh.stem) for mesh in meshes]
    else:
        print("no folder of real rocks: skipped")
    with given.out.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for name, kind, shown in places:
            table.writerow(row(name, kind, shown, config))
            file.flush()


if __name__ == "__main__":
    main()
