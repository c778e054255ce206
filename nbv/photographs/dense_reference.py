"""The dense reference of a set: its clouds, what of them is the object, how well halves agree, and its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from nbv.cache import cached
from nbv.config import CameraConfig, DenseConfig, EvaluationConfig
from nbv.config.presets import PHOTOGRAPH_SET_DEFAULTS
from nbv.dense import PosedViews, make_backend, patchmatch_runs
from nbv.dense.reconstruct import fuse
from nbv.dense.stereo import check_consistency, points_to_search, sgbm_depth_maps, shrunk, shrunk_camera
from nbv.errors import MissionFailure, UserError
from nbv.evaluation.cleaning import inlier_mask, select
from nbv.evaluation.registry import azimuth_sectors, f_score
from nbv.geometry.mesh import body_labels, drop_unused_vertices, face_areas
from nbv.geometry.target import GROUND_BAND_M
from nbv.geometry.visibility import nearest_neighbours
from nbv.photographs.import_source import ImportSource
from nbv.photographs.object_frame import ObjectFrame
from nbv.photographs.photograph_set import (
    THRESHOLD_FRACTIONS,
    HalvesAgreement,
    Photograph,
    Reference,
    read_image,
    read_mask,
)
from nbv.process import give_back_freed_memory
from nbv.rocks import Rock
from nbv.rocks.rock import make_rock
from nbv.rocks.texture import linear_from_srgb
from nbv.types import Floats, PointCloud

MAX_VIEWS = 140  # reconstructed at once: memory grows with them
DENSE_SIZE_PX = 800  # long side: a pixel is then finer than a voxel
WORKERS = 2
MIN_BASELINE_ANGLE_DEG = 60.0  # photographs one behind the other rectify to huge pictures
AGREEING_VIEWS: int = PHOTOGRAPH_SET_DEFAULTS["dense.agreeing_views"]
VOXEL_M = 0.008
SECTORS = 12
WEAK_SHARE = 0.25  # of a sector's points beyond the middle threshold make it weak
SPARSE_SHARE = 0.3  # of the median number of points in a sector make it thin
FEWEST_POINTS = 1000
SURFACE_DEPTH = 8  # of the octree: cells of 1/256 of the object
SURFACE_REACH = 0.06  # of the height: surface farther from any reference point is invention and left out
_SURFACE_POINTS = 300_000
_WEAK_AT = THRESHOLD_FRACTIONS[2]


@dataclass(frozen=True)
class ReferenceMaker:
    """Makes the clouds of a set's photographs near the object."""

    source: ImportSource  # its progress and store
    folder: Path  # with the undistorted photographs and masks
    camera: CameraConfig  # their pinhole
    frame: ObjectFrame
    sparse_points_m: Floats  # (N, 3) surface is sought near these; else close photographs take very long

    def cloud(self, views: Sequence[Photograph], what: str) -> PointCloud:
        """The object's part of the dense cloud of some photographs; ``what`` names them in messages of progress.

        More than `MAX_VIEWS` are reconstructed in interleaved parts, whose clouds are joined. Errors as `object_cloud`.
        """
        config = DenseConfig(
            backend="patchmatch" if patchmatch_runs() else "sgbm",
            crop_half_width_m=round(1.15 * self.frame.half_width_m, 3),
            search="sparse",
            min_baseline_angle_deg=MIN_BASELINE_ANGLE_DEG,
            agreeing_views=AGREEING_VIEWS,
            fusion_voxel_m=VOXEL_M,
        )
        near_m = points_to_search(self.sparse_points_m, self.frame.center_m, config)
        parts = -(-len(views) // MAX_VIEWS)
        clouds = []
        for part in range(parts):
            members = views[part::parts]
            label = what if parts == 1 else f"{what}, part {part + 1} of {parts}"
            entry = cached(
                self.source.store,
                "photograph-clouds",
                partial(self._fused, members, config, near_m, label),
                code=__name__,
                inputs=[
                    [(v.name, v.sha256, v.masked) for v in members],
                    np.array([read_mask(self.folder, v.name, self.camera) for v in members if v.masked]),
                    np.array([v.camera_from_world for v in members]),
                    self.camera,
                    config,
                    self.frame.center_m,
                    np.zeros((0, 3)) if near_m is None else near_m,
                ],
            )
            clouds.append(PointCloud(**entry))
        if parts == 1:
            return object_cloud(clouds[0], self.frame)
        # The points of all parts, one a voxel: the first of each.
        points = np.concatenate([c.points_m for c in clouds])
        _, first = np.unique(np.floor(points / VOXEL_M).astype(np.int64), axis=0, return_index=True)
        first.sort()
        colors = np.concatenate([c.colors for c in clouds if c.colors is not None])
        normals = np.concatenate([c.normals for c in clouds if c.normals is not None])
        return object_cloud(PointCloud(points[first], colors[first], normals[first]), self.frame)

    def _fused(
        self, views: Sequence[Photograph], config: DenseConfig, near_m: Floats | None, what: str
    ) -> dict[str, np.ndarray]:
        """The fields of the cloud fused from the depth maps of ``views``; of no point where fusion fails."""
        small = shrunk_camera(self.camera, DENSE_SIZE_PX)
        posed = PosedViews(
            {v.name: shrunk(read_image(self.folder, v.name, self.camera), small) for v in views},
            {v.name: v.camera_from_world for v in views if v.camera_from_world is not None},
            small,
            self.frame.center_m,
            config,
            near_m,
        )
        progress = self.source.progress
        if config.backend == "sgbm":
            maps = sgbm_depth_maps(posed, WORKERS, lambda done: progress(what, done, len(views)))
        else:
            maps = make_backend(config.backend)(posed)
        for name in maps:
            if (mask := read_mask(self.folder, name, self.camera)) is not None:
                size_px = (small.width_px, small.height_px)
                inside = cv2.resize(mask.astype(np.uint8), size_px, interpolation=cv2.INTER_AREA) > 0
                maps[name][~inside] = np.nan
        progress(f"{what}: comparing depths and fusing", 0, 1)
        try:
            cloud = fuse(check_consistency(maps, posed), posed)
        except MissionFailure:
            cloud = PointCloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3)))
        finally:
            give_back_freed_memory()
        assert cloud.colors is not None and cloud.normals is not None
        return {"points_m": cloud.points_m, "colors": cloud.colors, "normals": cloud.normals}


def object_cloud(cloud: PointCloud, frame: ObjectFrame) -> PointCloud:
    """The points in the object's box, off the ground unless all photographs have masks, without outliers; `UserError` where hardly any is left."""
    inside = frame.in_box(cloud.points_m)
    if not frame.masked:
        inside &= cloud.points_m[:, 2] > frame.low_m[2] + GROUND_BAND_M
    cleaned = select(cloud, inside)
    config = EvaluationConfig()
    if len(cleaned) > config.sor_neighbours:
        distances, _ = nearest_neighbours(cleaned.points_m, cleaned.points_m, k=config.sor_neighbours + 1)
        cleaned = select(cleaned, inlier_mask(distances[:, 1:], config.sor_std_ratio))
    if len(cleaned) < FEWEST_POINTS:
        raise UserError(
            f"only {len(cleaned)} points of the object could be reconstructed: too few photographs overlap, or they show "
            "nothing but plain surfaces; give more photographs of it, or masks of the object (--masks)"
        )
    return cleaned


def halves_agreement(
    whole: PointCloud, halves: Sequence[PointCloud], height_m: float
) -> tuple[HalvesAgreement, Floats]:
    """How completely each half's cloud covers that of all photographs and how well it is confirmed by the other half's.

    Thresholds are shares of the object's height. Also (N,) the distance of each point of ``whole`` to the worse half's cloud.
    """
    first, second = halves
    pairs = ((first, whole), (second, whole), (first, second), (second, first))
    distances_m = [nearest_neighbours(to.points_m, of.points_m)[0] for to, of in pairs]
    missing, wrong = distances_m[:2], distances_m[2:]
    completeness, precision = (
        tuple(
            float(np.mean([100 * np.mean(d < fraction * height_m) for d in both]))
            for fraction in THRESHOLD_FRACTIONS
        )
        for both in (missing, wrong)
    )
    scores = tuple(map(f_score, precision, completeness))
    return HalvesAgreement(completeness, precision, scores), np.maximum(*missing)


def weak_sectors(reference: Reference, height_m: float) -> tuple[str, ...]:
    """A sentence on the sides where hardly a point is, and one on those where the halves disagree."""
    sector = azimuth_sectors(reference.points_m, (0.0, 0.0, 0.0), SECTORS)
    counts = np.bincount(sector, minlength=SECTORS)
    weak = np.bincount(sector, weights=reference.error_m > _WEAK_AT * height_m, minlength=SECTORS)
    thin = counts < SPARSE_SHARE * np.median(counts)
    share = weak / np.maximum(counts, 1)
    sentences = []
    for which, words in (
        (thin, "hardly any points"),
        (
            ~thin & (share > WEAK_SHARE),
            f"more than {100 * WEAK_SHARE:.0f} % of the points are farther than {100 * _WEAK_AT:.0f} % of the height from the "
            "cloud of one half",
        ),
    ):
        step = 360 // SECTORS
        where = ", ".join(f"{step * i}° to {step * (i + 1)}°" for i in np.flatnonzero(which).tolist())
        if where:
            sentences.append(f"{words} at {'all azimuths' if which.all() else f'azimuths {where}'}")
    return tuple(sentences)


def surface_of(reference: Reference, name: str, height_m: float) -> Rock:
    """Screened Poisson reconstruction (Kazhdan and Hoppe 2013, Open3D's), cut off where there are no points.

    `UserError` where the reference is too small for a surface.
    """
    import open3d as o3d  # noqa: PLC0415  seconds to load

    step = max(1, len(reference) // _SURFACE_POINTS)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(reference.points_m[::step]))
    cloud.normals = o3d.utility.Vector3dVector(reference.normals[::step])
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=SURFACE_DEPTH, n_threads=1
    )
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)
    away, nearest = nearest_neighbours(reference.points_m, vertices)
    faces = faces[(away[faces] <= SURFACE_REACH * height_m).all(axis=1)]
    if len(faces):
        labels = body_labels(faces)
        areas = np.bincount(labels, weights=face_areas(vertices, faces))
        faces = faces[areas[labels] >= 0.05 * areas.max()]
    if len(faces) < 100:
        raise UserError("the reference has too few points for a surface; give more photographs of the object")
    # Albedo rides along as three more coordinates.
    albedo = linear_from_srgb((reference.colors[nearest] / 255.0).astype(np.float32))
    values, faces = drop_unused_vertices(np.hstack([vertices, albedo]), faces)
    return make_rock(
        name,
        values[:, :3],
        faces,
        values[:, 3:].astype(np.float32),
        split="extra",
        difficulty="meshed from photographs",
        notes=(f"Poisson surface of {len(reference)} reference points; open where nothing was seen",),
    )
