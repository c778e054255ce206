"""A set of photographs of a ball whose true surface is its reference: rendered, small, poses exact."""

import shutil
from dataclasses import replace

import numpy as np
import trimesh
from PIL import Image
from rendered_photographs import CAMERA, render
from scene_helpers import BALL_RADIUS_M, CENTRE_M, around, make_ball

from nbv.geometry.frames import look_at
from nbv.photographs import PhotographSet
from nbv.photographs.photograph_set import HalvesAgreement, Photograph, Reference, set_folder
from nbv.rocks.catalogue import write_rock
from nbv.rocks.rock import make_rock

HEIGHT_M = 2 * BALL_RADIUS_M


def spread(count: int) -> np.ndarray:
    """(count, 3) all round, at 15 to 40 degrees, as a hand would hold a camera."""
    rng = np.random.default_rng(0)
    azimuths = np.arange(count) * 360.0 / count + rng.normal(0, 2, count)
    return around(azimuths, rng.uniform(15, 40, count))


def write_set(name: str, positions_m: np.ndarray, *, rendered: bool) -> PhotographSet:
    """Keep the set ``name``; not rendered: photographs of one grey, for what does not look at them."""
    folder = set_folder(name)
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
    ball = make_ball()
    photographs = []
    for k, position in enumerate(positions_m):
        pose = look_at(position, CENTRE_M)
        picture = (
            render(position)
            if rendered
            else Image.new("RGB", (CAMERA.width_px, CAMERA.height_px), (128,) * 3)
        )
        picture.save(folder / "images" / f"p{k:03d}.jpg", quality=95)
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
        halves=HalvesAgreement(*[(90.0, 95.0, 99.0, 99.0, 99.0)] * 3),
        weak=(),
        notes=(),
        source_folder="rendered",
    )
    made.write(folder)
    return made


def write_part_of_a_set() -> PhotographSet:
    """The set ``mine``: six photographs over 200°, one without a pose, and what an import tells of them."""
    made = write_set("mine", around(np.linspace(0.0, 200.0, 6), 0.0), rendered=False)
    shutil.copy(made.folder / "images/p000.jpg", made.folder / "images/lost.jpg")
    lost = Photograph("lost", "LOST.JPG", "9" * 64, None, False)
    told = {"weak": ("azimuth 60° to 90°: hardly any points",), "notes": ("6 of 7 photographs registered",)}
    part = replace(
        made, photographs=(*made.photographs, lost), metres_per_unit=0.23, scale_source="length", **told
    )
    part.write(part.folder)
    return part
