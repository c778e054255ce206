"""The deterministic backend: Open3D rays on the rock, a closed form for the ground, no graphics driver.

Each pixel is integrated, not point-sampled: the ground by ``GROUND_ROWS`` sub-rows per pixel with a
mip level chosen from the footprint, the rock by 2 x 2 rays per pixel inside its projected box.
"""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from nbv.geometry.frames import intrinsic_matrix
from nbv.geometry.mesh import RayCaster
from nbv.scene.bake import GROUND_TINT, Scene
from nbv.scene.view import camera_position, grey_levels
from nbv.types import Floats, Floats32

_Box = tuple[int, int, int, int]  # rows from, to, columns from, to

GROUND_ROWS = 3  # sub-rows per pixel: towards the horizon a footprint is several times longer than wide
ROCK_SUBSAMPLES = 2  # per axis
FADE_START = 0.7  # of the clipmap's reach; from there the ground fades to its mean
SMALLEST_MIP_PX = 32


class RaycastRenderer:
    """Ray casting with baked light; equal input gives equal bits."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._caster = RayCaster(scene.vertices_m, scene.faces)
        self._k = intrinsic_matrix(scene.camera)
        # For the horizon, besides, halved copies of the coarsest level: level l has texels 2**l wide.
        self._mips = list(scene.ground_levels)
        while len(self._mips[-1]) >= 2 * SMALLEST_MIP_PX:
            half = len(self._mips[-1]) // 2
            self._mips.append(cv2.resize(self._mips[-1], (half, half), interpolation=cv2.INTER_AREA))
        self._face_radiance = scene.vertex_radiance[scene.faces]  # (F, 3, 3): one look-up a ray, not four
        self._ground_mean = np.float32(scene.ground_mean_radiance * 65535.0)
        # (8, 4) homogeneous corners of the box around the rock.
        x, y, z = zip(scene.vertices_m.min(0), scene.vertices_m.max(0))
        self._corners: Floats = np.array([(*corner, 1.0) for corner in itertools.product(x, y, z)])

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        matrix, position = np.asarray(camera_from_world, dtype=float), camera_position(camera_from_world)
        rays = _PixelRays(matrix[:3, :3], self._k)
        rgb = self._background(rays, position)
        if (box := self._rock_box(matrix)) is not None:
            self._draw_rock(rays, position, box, rgb)
        return grey_levels(rgb)

    def close(self) -> None:
        """There is nothing to free."""

    def _background(self, rays: _PixelRays, position: Floats) -> Floats32:
        """(H, W, 3) radiance of ground and sky."""
        camera = self._scene.camera
        columns = np.arange(camera.width_px) + 0.5
        grey = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
        sky = np.zeros_like(grey)
        for k in range(GROUND_ROWS):
            rows = np.arange(camera.height_px) + (k + 0.5) / GROUND_ROWS
            dz = rays.component(2, columns, rows)
            seen = dz < -1e-6
            sky += ~seen
            part = slice(int(seen.any(axis=1).argmax()), None)  # from the first row that sees ground
            down = np.minimum(dz[part], -1e-6)
            looked_up = self._look_up(rays, position, columns, rows[part], down)
            grey[part] += looked_up * seen[part]
        grey *= np.float32(1 / (65535.0 * GROUND_ROWS))
        sky *= np.float32(self._scene.sky_radiance / GROUND_ROWS)
        rgb = np.empty((*grey.shape, 3), dtype=np.float32)
        for channel in range(3):
            np.multiply(grey, GROUND_TINT[channel], out=rgb[..., channel])
            rgb[..., channel] += sky
        return rgb

    def _look_up(
        self,
        rays: _PixelRays,
        position: Floats,
        columns: NDArray[np.floating],
        rows: NDArray[np.floating],
        dz: Floats32,
    ) -> Floats32:
        """Trilinear ground radiance (0..65535) at one sample per pixel, where the ray meets the ground."""
        spec = self._scene.ground_spec
        dx, dy = rays.component(0, columns, rows), rays.component(1, columns, rows)
        t = np.float32(-position[2]) / dz
        reach = np.float32(spec.reach_m)
        x = np.clip(t * dx + np.float32(position[0]), -reach, reach)
        y = np.clip(t * dy + np.float32(position[1]), -reach, reach)
        farthest = np.maximum(np.abs(x), np.abs(y))

        # Footprint of a sample: t / f across; along, longer by the grazing angle, shared by the sub-rows.
        stretch = (dx * dx + dy * dy + dz * dz) / (np.float32(-GROUND_ROWS) * dz)
        footprint = t * np.maximum(stretch, 1) * np.float32(1 / (self._k[0, 0] * spec.texel_m))
        # A level is used only well inside its square: the lower of the two blended reaches twice as far.
        inside = farthest * np.float32(2.02 / spec.half_extent_m(0))
        lod = np.log2(np.maximum(np.maximum(footprint, inside), 1))
        np.minimum(lod, np.float32(len(self._mips) - 1), out=lod)

        total = np.zeros_like(t)
        for level in range(int(lod.min()), int(np.ceil(lod.max())) + 1):
            weight = np.maximum(1 - np.abs(lod - np.float32(level)), 0)
            used = np.flatnonzero(weight.any(axis=1))
            if not len(used):
                continue
            part = slice(int(used[0]), int(used[-1]) + 1)
            scale = np.float32(1 / (spec.texel_m * 2**level))
            shift = np.float32(len(self._mips[level]) / 2 - 0.5)
            value = cv2.remap(
                self._mips[level],
                x[part] * scale + shift,
                y[part] * scale + shift,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
            total[part] += weight[part] * value
        fade = np.clip((farthest / reach - FADE_START) / (1 - FADE_START), 0, 1)
        return total + fade * (self._ground_mean - total)

    def _rock_box(self, camera_from_world: Floats) -> _Box | None:
        """(r0, r1, c0, c1) around the rock's image; all of the image if the rock reaches behind the camera."""
        camera = self._scene.camera
        corners = self._corners @ camera_from_world[:3].T
        if (corners[:, 2] <= 0.01).all():
            return None
        if (corners[:, 2] <= 0.01).any():
            return 0, camera.height_px, 0, camera.width_px
        pixels = corners @ self._k.T
        uv = pixels[:, :2] / pixels[:, 2:]
        c0, r0 = np.floor(uv.min(0)).astype(int) - 1
        c1, r1 = np.ceil(uv.max(0)).astype(int) + 1
        r0, r1 = max(int(r0), 0), min(int(r1), camera.height_px)
        c0, c1 = max(int(c0), 0), min(int(c1), camera.width_px)
        return (r0, r1, c0, c1) if r0 < r1 and c0 < c1 else None

    def _draw_rock(self, rays: _PixelRays, position: Floats, box: _Box, rgb: Floats32) -> None:
        """Write the rock's radiance over ground and sky in ``box`` of ``rgb`` (H, W, 3).

        A pixel that the rock covers in part is a mixture, by the share of its rays, `ROCK_SUBSAMPLES` per axis, that hit.
        """
        r0, r1, c0, c1 = box
        n = ROCK_SUBSAMPLES
        fine_rows = r0 + (np.arange((r1 - r0) * n) + 0.5) / n
        fine_columns = c0 + (np.arange((c1 - c0) * n) + 0.5) / n
        bundle = np.empty((len(fine_rows), len(fine_columns), 6), dtype=np.float32)
        bundle[..., :3] = position
        for axis in range(3):
            bundle[..., 3 + axis] = rays.component(axis, fine_columns, fine_rows)
        hits = self._caster.cast(bundle)
        hit = hits.face < len(self._face_radiance)
        index = np.flatnonzero(hit)  # one index a ray: masks of two axes take longer
        corners = self._face_radiance.take(hits.face.take(index), axis=0)
        u, v = np.hsplit(hits.uv.reshape(-1, 2).take(index, axis=0), 2)
        radiance = np.zeros((*hit.shape, 3), dtype=np.float32)
        radiance.reshape(-1, 3)[index] = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        # Sums over a pixel's rays as whole arrays: NumPy's own over two axes takes five times as long.
        covered = np.zeros((r1 - r0, c1 - c0), dtype=np.float32)
        total = np.zeros((r1 - r0, c1 - c0, 3), dtype=np.float32)
        for row in range(n):
            for column in range(n):
                covered += hit[row::n, column::n]
                total += radiance[row::n, column::n]
        share = np.float32(1 / n**2)
        patch = rgb[r0:r1, c0:c1]
        patch *= (1 - share * covered)[..., None]
        patch += share * total


class _PixelRays:
    """World directions of image points, scaled so that the ray parameter is the z-depth.

    A direction is an affine function of (column, row), so a grid of them is an outer sum.
    """

    def __init__(self, camera_from_world_rotation: Floats, k: Floats) -> None:
        self._columns_of = camera_from_world_rotation.T @ np.linalg.inv(k)

    def component(self, axis: int, columns: NDArray[np.floating], rows: NDArray[np.floating]) -> Floats32:
        """(len(rows), len(columns)) one world component of the directions."""
        a, b, c = self._columns_of[axis]
        return (b * rows + c).astype(np.float32)[:, None] + (a * columns).astype(np.float32)
