"""How well sparse points alone tell what a candidate sees, against ray casting on the true mesh.

    OMP_NUM_THREADS=1 python benchmarks/occlusion_quality.py [--shared ../shared]

Reads the planning states of ../shared/golden/scorers (real reconstructions) and the meshes they show.
For every fourth candidate, every box point in its frustum is truly visible or not (a ray from the camera
meets nothing more than 4 cm before the point). Printed per test, for points on the rock (within 5 cm of the
mesh, above 5 cm) and the others (ground): share of visible points kept, share of hidden points rejected,
their mean (balanced accuracy), and the correlation over candidates between the number of rock points
kept and the number truly visible.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh

from nbv.config import MissionConfig
from nbv.scorers.occlusion import mean_observing_directions, unoccluded
from nbv.scorers.visibility import in_frustum

CASES = (
    ("15016_seed_paper_weights", "apollo_15016_0"),
    ("15016_40_views_low_novelty_10deg_ring", "apollo_15016_0"),
    ("65035_40_views_other_weights", "apollo_65035_0"),
)


def true_scene(path: Path) -> o3d.t.geometry.RaycastingScene:
    """The mesh as the reconstructions show it: 1.6 m tall, resting on z = 0, centred."""
    mesh = trimesh.load(path, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices)
    vertices = vertices * 1.6 / np.ptp(vertices[:, 2])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices -= [*((low + high) / 2)[:2], low[2]]
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(np.asarray(mesh.faces).astype(np.uint32)),
    )
    return scene


class Case:
    """Box points, candidates and the truth of one golden state."""

    def __init__(self, state: Path, mesh: Path) -> None:
        config = MissionConfig()
        with np.load(state) as z:
            lengths = np.bincount(z["track_point"], minlength=len(z["points_m"]))
            inside = (np.abs(z["points_m"] - z["target_m"]) <= 2.0).all(axis=1) & (lengths >= 2)
            order = np.argsort(z["track_point"], kind="stable")
            observed = inside[z["track_point"][order]]
            self.points = z["points_m"][inside]
            self.offsets = np.concatenate([[0], np.cumsum(lengths[inside])])
            self.cameras = z["track_camera"][order][observed].astype(np.int64)
            self.centers, self.candidates = z["camera_centers_m"], z["candidates_m"][::4]
        self.frustum = in_frustum(self.points, self.candidates, np.array(config.target_m), config.camera)
        scene = true_scene(mesh)
        to_point = self.points[:, None] - self.candidates[None]
        self.distance = np.linalg.norm(to_point, axis=2)
        rays = np.concatenate([np.broadcast_to(self.candidates[None], to_point.shape), to_point], axis=2)
        hit = scene.cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)), nthreads=1)[
            "t_hit"
        ].numpy()
        self.truth = self.frustum & (hit > 1.0 - 0.04 / self.distance)
        from_mesh = scene.compute_distance(
            o3d.core.Tensor.from_numpy(self.points.astype(np.float32)), nthreads=1
        )
        self.on_rock = (from_mesh.numpy() < 0.05) & (self.points[:, 2] > 0.05)

    def mean_ray_angle_deg(self) -> np.ndarray:
        """(P, C) angle between each candidate's ray and the point's mean observing ray."""
        mean = mean_observing_directions(self.points, self.offsets, self.cameras, self.centers)
        to_candidate = (self.candidates[None] - self.points[:, None]) / self.distance[..., None]
        return np.rad2deg(np.arccos(np.clip(np.einsum("pcj,pj->pc", to_candidate, mean), -1, 1)))

    def surfel_test(self) -> np.ndarray:
        """(P, C) what the scorers use with visibility.mode=occlusion."""
        return unoccluded(
            self.frustum, self.points, self.offsets, self.cameras, self.centers, self.candidates
        )

    def rates(self, visible: np.ndarray, rock: bool) -> tuple[float, float]:
        """Share of truly visible points kept and of hidden points rejected."""
        part = self.frustum & (self.on_rock if rock else ~self.on_rock)[:, None]
        truth, ours = self.truth[part], visible[part]
        return float(ours[truth].mean()), float((~ours)[~truth].mean())

    def correlation(self, visible: np.ndarray) -> float:
        """Over candidates: rock points kept against rock points truly visible."""
        ours, truth = (m[self.on_rock].sum(axis=0) for m in (visible, self.truth))
        return float(np.corrcoef(ours, truth)[0, 1]) if np.ptp(ours) > 0 else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shared", type=Path, default=Path(__file__).parents[2] / "shared")
    shared = parser.parse_args().shared
    for golden, rock in CASES:
        case = Case(shared / "golden" / "scorers" / f"{golden}.npz", shared / "rocks" / rock / f"{rock}.obj")
        print(f"{golden}: {case.on_rock.sum()} rock and {(~case.on_rock).sum()} ground points")
        angle = case.mean_ray_angle_deg()
        for name, visible in (
            ("frustum", case.frustum),
            ("mean observing ray < 60 deg", case.frustum & (angle < 60)),
            ("mean observing ray < 75 deg", case.frustum & (angle < 75)),
            ("surfels (visibility.mode=occlusion)", case.surfel_test()),
        ):
            (rk, rr), (gk, gr) = case.rates(visible, True), case.rates(visible, False)
            print(f"  {name:36s} rock: kept {rk:.3f} rejected {rr:.3f} balanced {(rk + rr) / 2:.3f}"
                  f" | ground: kept {gk:.3f} rejected {gr:.3f} balanced {(gk + gr) / 2:.3f}"
                  f" | correlation {case.correlation(visible):.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
