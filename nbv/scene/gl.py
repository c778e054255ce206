"""The rasterising backend: pyrender, unlit, with the baked radiance as vertex colours and textures.

Images differ in bits between graphics drivers, so results record which backend made them.
"""

from __future__ import annotations

import importlib
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.rocks.texture import srgb_from_linear
from nbv.scene.bake import GROUND_TINT, Scene
from nbv.scene.raycast import FADE_START
from nbv.scene.view import camera_position, grey_levels
from nbv.types import Floats, Floats32

NEAR_M, FAR_M = 0.05, 4000.0
HORIZON_M = 2000.0  # half extent of the plain ground beyond the clipmap


class GLRenderer:
    """OpenGL through EGL (or what ``PYOPENGL_PLATFORM`` says); ``UserError`` where there is none.

    Close it when another one is to be made in the same process.
    """

    def __init__(self, scene: Scene) -> None:
        camera = scene.camera
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        try:
            self._pyrender = pyrender = importlib.import_module("pyrender")
        except Exception as error:  # PyOpenGL raises ImportError, AttributeError or OSError by platform
            raise UserError(_no_gl(error)) from error
        sky = float(srgb_from_linear(np.array(scene.sky_radiance)))
        self._gl_scene = pyrender.Scene(bg_color=(sky, sky, sky, 0.0))
        colors = np.ones((len(scene.vertices_m), 4), dtype=np.float32)
        colors[:, :3] = srgb_from_linear(scene.vertex_radiance)
        rock = pyrender.Primitive(
            positions=scene.vertices_m,
            indices=scene.faces,
            color_0=colors,
            material=pyrender.MetallicRoughnessMaterial(doubleSided=True),
        )
        self._gl_scene.add(pyrender.Mesh([rock]))
        for level in range(scene.ground_spec.levels):
            self._gl_scene.add(self._ground_mesh(scene, level))
        vertices, faces = square_frame(scene.ground_spec.reach_m, HORIZON_M)
        tint = srgb_from_linear(scene.ground_mean_radiance * GROUND_TINT)
        self._gl_scene.add(self._flat_mesh(vertices, faces, None, None, (*map(float, tint), 0.0)))
        self._camera_node = self._gl_scene.add(
            pyrender.IntrinsicsCamera(
                camera.focal_px, camera.focal_px, camera.width_px / 2, camera.height_px / 2, NEAR_M, FAR_M
            )
        )
        try:
            self._offscreen: Any = pyrender.OffscreenRenderer(camera.width_px, camera.height_px)
            above = look_at(np.array([0.0, 0.0, 50.0]), np.zeros(3))
            self.rgb(above)  # uploads everything and finds a broken driver now
        except UserError:
            raise
        except Exception as error:  # PyOpenGL and the drivers raise what they like
            raise UserError(_no_gl(error)) from error

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        camera_position(camera_from_world)
        gl_from_cv = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL cameras look along -z with y up
        pose = np.linalg.inv(np.asarray(camera_from_world, dtype=float)) @ gl_from_cv
        self._gl_scene.set_pose(self._camera_node, pose)
        flags = self._pyrender.RenderFlags
        rgb, _ = self._offscreen.render(self._gl_scene, flags=flags.FLAT | flags.SKIP_CULL_FACES)
        return np.ascontiguousarray(rgb)

    def close(self) -> None:
        """Give the GL context back."""
        if self._offscreen is not None:
            self._offscreen.delete()
            self._offscreen = None

    def _ground_mesh(self, scene: Scene, level: int) -> Any:
        spec = scene.ground_spec
        half = spec.half_extent_m(level)
        radiance = scene.ground_levels[level].astype(np.float32) / np.float32(65535)
        if level == spec.levels - 1:  # the same fade to the mean as the ray caster's
            across = np.abs(np.linspace(-1, 1, spec.size_px, dtype=np.float32))
            far = np.maximum(across[:, None], across)
            fade = np.clip((far - FADE_START) / (1 - FADE_START), 0, 1)
            radiance += fade * (np.float32(scene.ground_mean_radiance) - radiance)
        # pyrender flips the rows on upload; flipped here, v grows with y.
        image = grey_levels(radiance[::-1, :, None] * GROUND_TINT)
        texture = self._pyrender.Texture(
            source=image,
            source_channels="RGB",
            sampler=self._pyrender.Sampler(wrapS=33071, wrapT=33071),  # GL_CLAMP_TO_EDGE
        )
        inner = spec.half_extent_m(level - 1) if level else 0.0
        vertices, faces = square_frame(inner, half)
        return self._flat_mesh(vertices, faces, texture, (vertices[:, :2] + half) / (2 * half))

    def _flat_mesh(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        texture: Any,
        uv: np.ndarray | None,
        color: tuple[float, ...] = (1.0, 1.0, 1.0, 0.0),
    ) -> Any:
        material = self._pyrender.MetallicRoughnessMaterial(
            baseColorTexture=texture, baseColorFactor=color, alphaMode="OPAQUE", doubleSided=True
        )
        primitive = self._pyrender.Primitive(
            positions=vertices.astype(np.float32),
            indices=faces,
            texcoord_0=None if uv is None else uv.astype(np.float32),
            material=material,
        )
        return self._pyrender.Mesh([primitive])


def _no_gl(error: Exception) -> str:
    text = " ".join(str(error).split())[:160] or type(error).__name__
    return (
        f"scene.backend=gl needs OpenGL ({os.environ.get('PYOPENGL_PLATFORM')}), and there is none here "
        f"({text}); use scene.backend=raycast, install Mesa (libegl1 libgl1 libgl1-mesa-dri) or set "
        "PYOPENGL_PLATFORM=osmesa"
    )


def square_frame(inner_m: float, outer_m: float) -> tuple[Floats32, NDArray[np.uint32]]:
    """Vertices (8, 3) and faces (8, 3) of a square of z = 0 around a square hole; (4, 3) and (2, 3) without one.

    ``inner_m`` and ``outer_m`` are half the sides of the hole and of the square.
    """
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float32)
    if inner_m <= 0:
        return np.float32(outer_m) * square, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    faces = [face for i in range(4) for j in [(i + 1) % 4] for face in ((i, j, 4 + j), (i, 4 + j, 4 + i))]
    vertices = np.concatenate([np.float32(outer_m) * square, np.float32(inner_m) * square])
    return vertices, np.array(faces, dtype=np.uint32)
