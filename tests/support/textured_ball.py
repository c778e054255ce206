"""A mesh file with a texture, as trimesh writes it."""

from pathlib import Path

import trimesh
from PIL import Image

PICTURE = "material_0.png"  # beside the mesh file


def write_ball(folder: Path, picture: Image.Image) -> Path:
    """A ball of radius 1 as OBJ, on which ``picture`` grows to the right along y and up along z."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.visual = trimesh.visual.TextureVisuals(uv=(ball.vertices[:, 1:] + 1) / 2, image=picture)
    path = folder / "ball.obj"
    ball.export(path)
    return path
