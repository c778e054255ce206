"""Draws which part of a target each of some missions misses, and where its cameras stood.

gatetune mission run --rock part-20001 ... --out runs/orbit    # and runs/planned
python -m research.picture_of_plans part-20001 runs/orbit "orbit at 15°" runs/planned "planned" --out docs/images/pocket.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import open3d as o3d
import pycolmap
from matplotlib.axes import Axes
from scipy.spatial import cKDTree

from nbv.geometry.ply import read_ply
from nbv.mission.result import MissionResult
from nbv.rocks.catalogue import load_rock
from nbv.rocks.rock import Rock

WITHIN_M = 0.048
PIXELS, WIDTH_M = 500, 1.7
SEED, PLANNED, MISSED = "#0072B2", "#D55E00", (0.85, 0.1, 0.2)


def axes_of(azimuth_deg: float, elevation_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and toward the spectator, unit vectors."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    toward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return right, np.cross(toward, right), toward


def surface(rock: Rock, cloud_m: np.ndarray, azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """(H, W, 3) the target from afar: grey within `WITHIN_M` of the cloud, red elsewhere, white beside it."""
    right, up, toward = axes_of(azimuth_deg, elevation_deg)
    centre = 0.5 * (rock.vertices_m.min(axis=0) + rock.vertices_m.max(axis=0))
    steps = (np.arange(PIXELS) / (PIXELS - 1) - 0.5) * WIDTH_M
    x, y = np.meshgrid(steps, -steps)
    origins = centre + x[..., None] * right + y[..., None] * up + 10.0 * toward
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(rock.vertices_m.astype(np.float32), rock.faces.astype(np.uint32))
    rays = np.concatenate([origins, np.broadcast_to(-toward, origins.shape)], axis=-1).astype(np.float32)
    hits = scene.cast_rays(o3d.core.Tensor(rays))
    distance, normals = hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
    seen = np.isfinite(distance)
    places = origins[seen] - distance[seen][:, None] * toward
    missed = cKDTree(cloud_m).query(places, workers=1)[0] > WITHIN_M
    shade = 0.35 + 0.6 * np.abs(normals[seen] @ toward)
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
    inset.plot(*(3.0 * axes_of(azimuth_deg, 0.0)[2][:2]), marker="*", color="black")
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
