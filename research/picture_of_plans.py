"""Draws which part of a target each of some missions misses, and where its cameras stood.

    ON="--rock part-20001 --condition indoors --set photographs=24 --set dense.agreeing_views=3 \\
        --set sparse.ground_features=2000 --set sparse.min_registered_seeds=6"
    gatetune mission run $ON --set seeds=12 --out runs/hyb-h
    gatetune mission run $ON --set seeds=24 --set seed.layout=turn --set seed.lowest_deg=15 --set seed.radius_m=3.5 --out runs/orbit
    gatetune mission run $ON --set seeds=10 --set gate.geometry_scorer=predicted --set predicted.weights.nov=0.01 \\
        --set predicted.weights.move=0.01 --set predicted.weights.ang=0.01 --out runs/planned
    python -m research.picture_of_plans part-20001 runs/hyb-h Hyb-H runs/orbit "orbit at 15°" runs/planned "tuned planner" \\
        --out docs/images/pocket.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pycolmap
from matplotlib.axes import Axes
from scipy.spatial import cKDTree

from nbv.geometry.frames import unit_vectors
from nbv.geometry.mesh import RayCaster, rays_of, weighted_normals
from nbv.geometry.ply import read_ply
from nbv.mission.result import MissionResult
from nbv.rocks.catalogue import load_rock
from nbv.rocks.rock import Rock

WITHIN_M = 0.048
PIXELS, WIDTH_M = 500, 1.7
SEED, PLANNED, MISSED = "#0072B2", "#D55E00", (0.85, 0.1, 0.2)


def surface(rock: Rock, cloud_m: np.ndarray, azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """(H, W, 3) the target from afar: grey within `WITHIN_M` of the cloud, red elsewhere, white beside it."""
    toward, right = unit_vectors(np.array([azimuth_deg, azimuth_deg + 90.0]), np.array([elevation_deg, 0.0]))
    up = np.cross(toward, right)
    centre = 0.5 * (rock.vertices_m.min(axis=0) + rock.vertices_m.max(axis=0))
    steps = (np.arange(PIXELS) / (PIXELS - 1) - 0.5) * WIDTH_M
    x, y = np.meshgrid(steps, -steps)
    origins = centre + x[..., None] * right + y[..., None] * up + 10.0 * toward
    hits = RayCaster(rock.vertices_m, rock.faces).cast(rays_of(origins, -toward))
    seen = np.isfinite(hits.t)
    places = origins[seen] - hits.t[seen][:, None] * toward
    missed = cKDTree(cloud_m).query(places, workers=1)[0] > WITHIN_M
    normals = weighted_normals(rock.vertices_m, rock.faces[hits.face[seen]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shade = 0.35 + 0.6 * np.abs(normals @ toward)
    picture = np.ones((PIXELS, PIXELS, 3))
    picture[seen] = shade[:, None] * np.where(missed[:, None], MISSED, (0.9, 0.9, 0.9))
    return picture


def draw(axes: Axes, rock: Rock, run: Path, name: str, azimuth_deg: float, elevation_deg: float) -> None:
    """One panel: the surface, and an inset with the cameras from above."""
    cloud, _ = read_ply(run / "cleaned.ply")
    axes.imshow(surface(rock, cloud.points_m, azimuth_deg, elevation_deg))
    axes.set_axis_off()
    score = MissionResult.load(run).metric("observable.f_score_48mm")
    images = pycolmap.Reconstruction(str(run / "sparse" / "0")).images.values()
    taken = [(image.name.startswith("seed"), *image.projection_center()) for image in images]
    planned = sum(not seed for seed, *_ in taken)
    axes.set_title(
        f"{name}: F {score:.1f}\n{len(taken) - planned} seeds, {planned} planned views", fontsize=10
    )
    inset = axes.inset_axes((0.74, 0.0, 0.26, 0.26))
    for seed, x, y, z in taken:
        inset.scatter(x, y, s=8 + 10 * z, color=SEED if seed else PLANNED, linewidths=0)
    east, north, _ = unit_vectors(np.array([azimuth_deg]), np.zeros(1))[0]
    inset.plot(3.0 * east, 3.0 * north, marker="*", color="black")
    inset.set(xlim=(-5, 5), ylim=(-5, 5), xticks=[], yticks=[], aspect="equal")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("target")
    parser.add_argument("runs", nargs="+", help="directory and name of every mission, in turn")
    parser.add_argument("--azimuth-deg", type=float, default=40.0)
    parser.add_argument("--elevation-deg", type=float, default=25.0)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    rock = load_rock(asked.target)
    pairs = list(zip(asked.runs[::2], asked.runs[1::2], strict=True))
    figure, panels = plt.subplots(
        1, len(pairs), figsize=(4.0 * len(pairs), 4.5), squeeze=False, layout="constrained"
    )
    for axes, (run, name) in zip(panels[0], pairs, strict=True):
        draw(axes, rock, Path(run), name, asked.azimuth_deg, asked.elevation_deg)
    figure.savefig(asked.out, dpi=110, bbox_inches="tight", pad_inches=0.1)


if __name__ == "__main__":
    main()
