"""Light computed once: the sun does not move and the surfaces are Lambertian, so radiance does not depend on the view.

Rock: a linear radiance per vertex. Ground: a clipmap of linear radiance with the rock's cast shadow.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.cache import Arrays, Store, cached
from nbv.config import CameraConfig, SceneConfig
from nbv.geometry.mesh import RayCaster, rays_of, vertex_normals
from nbv.rocks.rock import Rock
from nbv.rocks.texture import linear_from_srgb
from nbv.scene.ground import GroundSpec, synthesise_ground
from nbv.types import Floats, Floats32

GROUND_TINT = np.array([1.0, 0.985, 0.955], dtype=np.float32)  # regolith is very slightly warm
_FULL_SCALE = 65535.0  # radiance 1.0 in the stored 16-bit textures


@dataclass(frozen=True, eq=False)
class Scene:
    """A rock on the ground under the sun, baked; with the camera that looks at it."""

    vertices_m: Floats32  # (V, 3)
    faces: NDArray[np.uint32]  # (F, 3)
    vertex_radiance: Floats32  # (V, 3) linear
    ground_spec: GroundSpec
    ground_levels: tuple[NDArray[np.uint16], ...]  # per level (S, S) grey radiance, 65535 is 1.0
    sky_radiance: float  # linear grey
    camera: CameraConfig

    @property
    def ground_mean_radiance(self) -> float:
        """Grey radiance of the ground beyond the clipmap."""
        return float(self.ground_levels[-1].mean() / _FULL_SCALE)


def direction_to_sun(config: SceneConfig) -> Floats:
    """(3,) unit vector."""
    travel = np.asarray(config.sun_travel, dtype=float)
    return -travel / np.linalg.norm(travel)


def build_scene(
    rock: Rock,
    config: SceneConfig,
    camera: CameraConfig,
    ground: GroundSpec | None = None,
    store: Store | None = None,
) -> Scene:
    """Bake the light on a rock and its ground, or read it from ``store``."""
    spec = ground or GroundSpec()
    to_sun = direction_to_sun(config)
    vertices, faces = rock.vertices_m.astype(np.float32), rock.faces.astype(np.uint32)
    geometry: dict[str, Any] = {"spec": dataclasses.asdict(spec), "sun": config.sun_travel}
    light = {"irradiance": config.sun_irradiance, "ambient": config.ambient}

    def ground_arrays() -> Arrays:
        arrays = {}
        for level, (albedo, sun_cosine) in enumerate(synthesise_ground(config.ground_seed, to_sun, spec)):
            arrays[f"albedo_{level}"] = np.rint(albedo * _FULL_SCALE).astype(np.uint16)
            arrays[f"sun_{level}"] = np.rint(sun_cosine * 255).astype(np.uint8)
        return arrays

    def rock_arrays() -> Arrays:
        caster = RayCaster(vertices, faces)
        arrays: Arrays = {"radiance": vertex_radiance(rock.albedo, vertices, faces, config, to_sun, caster)}
        # The box around the rock's shadow on z = 0.
        shadow = vertices[:, :2] - vertices[:, 2:] * (to_sun[:2] / to_sun[2]).astype(np.float32)
        (x0, y0), (x1, y1) = shadow.min(0).tolist(), shadow.max(0).tolist()
        for level in range(spec.levels):
            bounds, sunlit = _ground_sunlit((x0, x1, y0, y1), level, spec, to_sun, caster)
            arrays[f"shadow_box_{level}"], arrays[f"sunlit_{level}"] = bounds, sunlit
        return arrays

    def stored(kind: str, bake: Callable[[], Arrays], **inputs: Any) -> Arrays:
        return cached(store, kind, bake, code=__name__, inputs=[inputs])

    surface = stored(
        "scene-ground",
        ground_arrays,
        seed=config.ground_seed,
        **geometry,
    )
    rock_light = stored(
        "scene-rock",
        rock_arrays,
        rock=rock.sha256,
        **geometry,
        **light,
    )

    levels = []
    for level in range(spec.levels):
        albedo = surface[f"albedo_{level}"].astype(np.float32) / np.float32(_FULL_SCALE)
        sun = surface[f"sun_{level}"].astype(np.float32) * np.float32(config.sun_irradiance / 255)
        r0, r1, c0, c1 = rock_light[f"shadow_box_{level}"]
        sun[r0:r1, c0:c1] *= rock_light[f"sunlit_{level}"].astype(np.float32) / np.float32(255)
        radiance = albedo * (np.float32(config.ambient) + sun)
        levels.append(np.rint(np.clip(radiance, 0, 1) * np.float32(_FULL_SCALE)).astype(np.uint16))
    return Scene(
        vertices,
        faces,
        rock_light["radiance"],
        spec,
        tuple(levels),
        float(linear_from_srgb(np.array(config.sky_grey))),
        camera,
    )


def vertex_radiance(
    albedo: NDArray[np.floating],
    vertices: Floats32,
    faces: NDArray[np.uint32],
    config: SceneConfig,
    to_sun: Floats,
    caster: RayCaster,
) -> Floats32:
    """albedo (V, 3) * (ambient * mild sky term + sun * max(0, n.l) * visibility), linear; ``to_sun`` (3,) is a unit vector."""
    normals = vertex_normals(vertices.astype(np.float64), faces.astype(np.int64))
    cosine = np.maximum(normals @ to_sun, 0)
    lit = np.flatnonzero(cosine > 0)
    # Start a little off the surface, or a vertex would be shadowed by its own triangles.
    origins = vertices[lit] + 0.004 * normals[lit] + 0.002 * to_sun
    cosine[lit[caster.blocked(rays_of(origins, to_sun))]] = 0
    sky = 0.85 + 0.15 * normals[:, 2]  # the ground below is a little darker than the sky
    light = config.ambient * sky + config.sun_irradiance * cosine
    return (np.asarray(albedo, dtype=np.float64) * light[:, None]).astype(np.float32)


def _ground_sunlit(
    box: tuple[float, float, float, float],
    level: int,
    spec: GroundSpec,
    to_sun: Floats,
    caster: RayCaster,
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Texel bounds (r0, r1, c0, c1) of the shadow's box, (x0, x1, y0, y1), and the sunlit part of each texel, 255 is all of it."""
    texel, half = spec.texel_m * 2**level, spec.half_extent_m(level)

    def clamp(value_m: float, up: bool) -> int:
        index = (value_m + half) / texel
        return min(max(math.ceil(index) + 1 if up else math.floor(index) - 1, 0), spec.size_px)

    c0, c1, r0, r1 = clamp(box[0], False), clamp(box[1], True), clamp(box[2], False), clamp(box[3], True)
    # Sub-samples per axis: a partly shaded texel is grey, not jagged.
    sub = 3 if level == 0 else 4
    xs = (np.arange(c0 * sub, c1 * sub) + 0.5) * texel / sub - half
    ys = (np.arange(r0 * sub, r1 * sub) + 0.5) * texel / sub - half
    sunlit = np.empty((r1 - r0, c1 - c0), dtype=np.uint8)
    for row in range(r1 - r0):  # row by row, so that memory stays small for a low sun's long shadow
        gx, gy = np.meshgrid(xs, ys[row * sub : (row + 1) * sub])
        origins = np.stack([gx.ravel(), gy.ravel(), np.full(gx.size, 1e-4)], axis=1)
        dark = caster.blocked(rays_of(origins, to_sun)).reshape(sub, c1 - c0, sub)
        sunlit[row] = np.rint(255 * (1 - dark.mean(axis=(0, 2))))
    return np.array([r0, r1, c0, c1]), sunlit
