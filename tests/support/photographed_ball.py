"""A set of photographs of a ball whose true surface is its reference: rendered, small, poses exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import trimesh
from PIL import Image
from scene_helpers import BALL_RADIUS_M, SMALL_GROUND, make_ball

from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.frames import look_at
from nbv.photographs import HalvesAgreement, Photograph, PhotographSet, Reference
from nbv.photographs.photograph_set import set_folder
from nbv.rocks.catalogue import write_rock
from nbv.rocks.rock import make_rock
from nbv.scene import build_scene, make_renderer

HEIGHT_M = 2 * BALL_RADIUS_M
CAMERA = CameraConfig(width_px=480, height_px=360, focal_px=420.0)
CENTRE_M = np.array([0.0, 0.0, BALL_RADIUS_M])


def places(azimuths_deg: np.ndarray, elevations_deg: np.ndarray, radius_m: float = 3.5) -> np.ndarray:
    """(N, 3) about the ball's centre."""
    a, e = np.deg2rad(azimuths_deg), np.deg2rad(elevations_deg)
    return CENTRE_M + radius_m * np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def spread(count: int) -> np.ndarray:
    """(count, 3) all round, at 15 to 40 degrees, as a hand would hold a camera."""
    rng = np.random.default_rng(0)
    azimuths = np.arange(count) * 360.0 / count + rng.normal(0, 2, count)
    return places(azimuths, rng.uniform(15, 40, count), 3.5)


def write_set(name: str, positions_m: np.ndarray, *, rendered: bool) -> PhotographSet:
    """Keep the set ``name``; not rendered: photographs of one grey, for what does not look at them."""
    folder = set_folder(name)
    for part in ("images", "masks", "sparse"):
        (folder / part).mkdir(parents=True)
    ball = make_ball()
    renderer = None
    if rendered:
        renderer = make_renderer(build_scene(ball, SceneConfig(), CAMERA, ground=SMALL_GROUND), "raycast")
    photographs = []
    for k, position in enumerate(positions_m):
        pose = look_at(position, CENTRE_M)
        grey = np.full((CAMERA.height_px, CAMERA.width_px, 3), 128, np.uint8)
        picture = grey if renderer is None else renderer.rgb(pose)
        Image.fromarray(picture).save(folder / "images" / f"p{k:03d}.jpg", quality=95)
        photographs.append(Photograph(f"p{k:03d}", f"p{k:03d}.jpg", f"{k:064d}", pose, False))
    mesh = trimesh.Trimesh(ball.vertices_m, ball.faces, process=False)
    points, _ = trimesh.sample.sample_surface(mesh, 40_000, seed=0)
    points = points[points[:, 2] > 0.2]
    normals = (points - CENTRE_M) / BALL_RADIUS_M
    colors = np.full((len(points), 3), 128, np.uint8)
    Reference(points, normals, colors, np.full(len(points), 0.001)).write(folder / "reference.ply")
    write_rock(
        make_rock(name, ball.vertices_m, ball.faces, ball.albedo, split="extra", difficulty="a ball"),
        folder / "surface.npz",
    )
    _write_tracks(folder / "sparse", photographs, points[:: len(points) // 300])
    made = PhotographSet(
        name=name,
        folder=folder,
        camera=CAMERA,
        photographs=tuple(photographs),
        height_m=HEIGHT_M,
        extents_m=(HEIGHT_M,) * 3,
        metres_per_unit=None,
        scale_source="none",
        reference_error_m=0.001,
        halves=HalvesAgreement(
            (90.0, 95.0, 99.0, 99.0, 99.0), (90.0, 95.0, 99.0, 99.0, 99.0), (90.0, 95.0, 99.0, 99.0, 99.0)
        ),
        weak=(),
        notes=(),
        source_folder="rendered",
    )
    made.write(folder)
    return made


def _write_tracks(folder: Path, photographs: list[Photograph], points: np.ndarray) -> None:
    """Every point is tracked in the photographs that face it within 60 degrees."""
    model = pycolmap.Reconstruction()
    params = [CAMERA.focal_px, CAMERA.focal_px, CAMERA.width_px / 2, CAMERA.height_px / 2]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(
            model="PINHOLE", width=CAMERA.width_px, height=CAMERA.height_px, params=params, camera_id=1
        )
    )
    for i, photograph in enumerate(photographs, 1):
        image = pycolmap.Image(name=f"{photograph.name}.jpg", camera_id=1, image_id=i)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.zeros(2)) for _ in points])
        pose = photograph.camera_from_world
        model.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:3, :3]), pose[:3, 3])
        )
    for j, point in enumerate(points):
        normal = (point - CENTRE_M) / BALL_RADIUS_M
        track = pycolmap.Track()
        for i, photograph in enumerate(photographs, 1):
            to_camera = photograph.camera_center_m - point
            if to_camera @ normal > 0.5 * np.linalg.norm(to_camera):
                track.add_element(i, j)
        if track.length() >= 2:
            model.add_point3D(point, track, np.zeros(3, dtype=np.uint8))
    model.write(str(folder))
