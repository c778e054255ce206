"""The path-traced backend: Mitsuba 3, with a lunar reflectance in place of our baked Lambertian light.

The rock, its shadow and the light that rock and ground throw at each other are traced; the ground's pebbles and
craters are painted on its reflectance, as they are in the other backends. Grey, with one warm tint for all.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.errors import UserError
from nbv.scene.bake import (
    GROUND_TINT,
    Scene,
    direction_to_sun,
    relief_within,
    square_frame,
    vertex_normals,
)
from nbv.scene.view import RenderedView, camera_position, grey_levels
from nbv.types import Floats

HORIZON_M = 2000.0  # half extent of the plain ground beyond the clipmap
NEAR_M, FAR_M = 0.01, 10_000.0
VARIANT = "scalar_rgb"  # the only one that needs neither LLVM nor CUDA
TABLE_ANGLES, TABLE_SIZE = 17, 32
# LROC Empirical, 2019 version, 600 nm: 760,000 tiles of lunar surface (ISIS 8.3, application lronacpho).
_LROC = (-1.479654495, -0.000083528, 0.012964707, -0.237774774, 0.556075496, 0.663671460, -0.439918609)


def lunar_reflectance(
    cos_incidence: Floats | float, cos_emission: Floats | float, phase_deg: Floats | float
) -> Floats:
    """Radiance of the Moon's soil under a sun of irradiance pi, relative to its albedo.

    ``mu0 / (mu + mu0) exp(B0 + B1 a^2 + B2 a + B3 sqrt(a) + B4 mu + B5 mu0 + B6 mu0^2)``, divided so that it is a
    Lambertian surface's where the Moon's reflectance is normalised: sun at 30 degrees, seen from straight above.
    """
    reference = _lroc(math.cos(math.radians(30)), 1.0, 30.0) / math.cos(math.radians(30))
    return _lroc(cos_incidence, cos_emission, phase_deg) / reference


def _lroc(mu0: Floats | float, mu: Floats | float, phase_deg: Floats | float) -> Floats:
    b0, b1, b2, b3, b4, b5, b6 = _LROC
    a = np.asarray(phase_deg, dtype=float)
    exponent = b0 + b1 * a**2 + b2 * a + b3 * np.sqrt(a) + b4 * mu + b5 * mu0 + b6 * np.square(mu0)
    return mu0 / (mu + mu0) * np.exp(exponent)


class MitsubaRenderer:
    """Path tracing on one thread; equal input gives equal bits. ``UserError`` without the package."""

    name = "mitsuba"

    def __init__(self, scene: Scene) -> None:
        self._mi = mi = _import_mitsuba()
        self._scene = scene
        light = scene.light
        self._depth = {"type": "aov", "aovs": "point:position,shape:shape_index"}
        self._path = {"type": "path", "max_depth": light.mitsuba_depth, "hide_emitters": True}
        to_sun = direction_to_sun(light)
        world: dict[str, Any] = {
            "type": "scene",
            "sun": {
                "type": "directional",
                "direction": [float(-x) for x in to_sun],
                "irradiance": {"type": "rgb", "value": math.pi * light.sun_irradiance},
            },
        }
        if light.ambient > 0:
            world["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": light.ambient}}
        with tempfile.TemporaryDirectory(prefix="gatetune-brdf-") as folder:
            table = str(Path(folder) / "lunar.bsdf")
            with contextlib.redirect_stdout(None):  # it says what it writes
                mi.tensor_io.write(table, **_lunar_table())
            world["rock"] = self._solid("rock", table, slice(0, scene.rock_faces))
            if len(scene.part_ends) > 1:
                world["neighbours"] = self._solid("neighbours", table, slice(scene.rock_faces, None))
            for level, texture in enumerate(scene.ground_reflectance()):
                world[f"ground_{level}"] = self._ground(level, texture, table)
            world["plain"] = self._plain(float(texture.mean()), table)
            self._world = mi.load_dict(world)
        # Shapes are counted from 1.
        self._rock_index = 1 + [shape.id() for shape in self._world.shapes()].index("rock")

    def render(self, camera_from_world: Floats) -> RenderedView:
        """See ``Renderer.render``."""
        rgb = self.rgb(camera_from_world)
        # One ray through each pixel's centre: a stratum of one, without jitter.
        sampler = {"type": "stratified", "sample_count": 1, "jitter": False}
        aovs = self._trace(camera_from_world, self._depth, sampler, seed=0)
        matrix = np.asarray(camera_from_world, dtype=float)
        hit = aovs[..., :3].any(axis=-1)
        depth = np.where(hit, aovs[..., :3] @ matrix[2, :3] + matrix[2, 3], np.inf).astype(np.float32)
        return RenderedView(rgb, depth, hit & (np.rint(aovs[..., 3]) == self._rock_index))

    def rgb(self, camera_from_world: Floats) -> NDArray[np.uint8]:
        """See ``Renderer.rgb``."""
        camera_position(camera_from_world)
        sampler = {"type": "multijitter", "sample_count": self._scene.light.mitsuba_samples}
        # The noise belongs to the pose: the same pattern in every photograph would be features of its own.
        seed = zlib.crc32(np.ascontiguousarray(camera_from_world, dtype=float).tobytes())
        rgba = self._trace(camera_from_world, self._path, sampler, seed)
        sky = (1 - rgba[..., 3:]) * np.float32(self._scene.sky_radiance)
        return grey_levels(rgba[..., :3] * GROUND_TINT + sky)

    def close(self) -> None:
        """Let the scene go."""
        del self._world

    def _trace(
        self, camera_from_world: Floats, integrator: dict[str, Any], sampler: dict[str, Any], seed: int
    ) -> NDArray[np.float32]:
        mi, camera = self._mi, self._scene.camera
        mitsuba_from_cv = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's cameras look along z with x to the left
        pose = np.linalg.inv(np.asarray(camera_from_world, dtype=float)) @ mitsuba_from_cv
        sensor = {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(camera.width_px / (2 * camera.focal_px))),
            "fov_axis": "x",
            "near_clip": NEAR_M,
            "far_clip": FAR_M,
            "to_world": mi.ScalarTransform4f(pose),
            "film": {
                "type": "hdrfilm",
                "width": camera.width_px,
                "height": camera.height_px,
                "rfilter": {"type": "box"},
                "pixel_format": "rgba" if integrator is self._path else "rgb",
                "component_format": "float32",
            },
            "sampler": sampler,
        }
        image = mi.render(
            self._world, sensor=mi.load_dict(sensor), integrator=mi.load_dict(integrator), seed=seed
        )
        return np.array(image, dtype=np.float32)

    def _solid(self, name: str, table: str, part: slice) -> Any:
        scene = self._scene
        albedo = np.asarray(scene.albedo, dtype=np.float32).mean(axis=1)
        bsdf = _lunar({"type": "mesh_attribute", "name": "vertex_albedo"}, table)
        normals = vertex_normals(scene.vertices_m, scene.faces)
        mesh = self._mesh(name, scene.vertices_m, scene.faces[part], bsdf, normals=normals)
        mesh.add_attribute("vertex_albedo", 1, np.ascontiguousarray(albedo))
        return mesh

    def _ground(self, level: int, texture: NDArray[np.float32], table: str) -> Any:
        spec = self._scene.ground_spec
        inner = spec.half_extent_m(level - 1) if level else 0.0
        vertices, faces = square_frame(inner, spec.half_extent_m(level))
        normals = None
        if level == 0 and (relief := self._scene.relief) is not None:
            vertices, faces = relief_within(relief, spec.half_extent_m(0))
            normals = vertex_normals(vertices, faces)
        bitmap = {
            "type": "bitmap",
            "data": self._mi.TensorXf(np.ascontiguousarray(texture[::-1, :, None])),  # v grows with y
            "raw": True,
            "wrap_mode": "clamp",
        }
        uv = vertices[:, :2] / (2 * spec.half_extent_m(level)) + 0.5
        return self._mesh(f"ground_{level}", vertices, faces, _lunar(bitmap, table), normals=normals, uv=uv)

    def _plain(self, reflectance: float, table: str) -> Any:
        vertices, faces = square_frame(self._scene.ground_spec.reach_m, HORIZON_M)
        return self._mesh("plain", vertices, faces, _lunar(reflectance, table))

    def _mesh(
        self,
        name: str,
        vertices: NDArray[np.floating],
        faces: NDArray[np.integer],
        bsdf: dict[str, Any],
        *,
        normals: NDArray[np.floating] | None = None,
        uv: NDArray[np.floating] | None = None,
    ) -> Any:
        mi = self._mi
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(bsdf)
        mesh = mi.Mesh(name, len(vertices), len(faces), properties, normals is not None, uv is not None)
        values = mi.traverse(mesh)
        values["vertex_positions"] = np.ravel(vertices).astype(np.float32)
        values["faces"] = np.ravel(faces).astype(np.uint32)
        if normals is not None:
            values["vertex_normals"] = np.ravel(normals).astype(np.float32)
        if uv is not None:
            values["vertex_texcoords"] = np.ravel(uv).astype(np.float32)
        values.update()
        return mesh


def _import_mitsuba() -> Any:
    try:
        mi, dr = importlib.import_module("mitsuba"), importlib.import_module("drjit")
    except ImportError as error:
        raise UserError(
            'scene.backend=mitsuba needs Mitsuba 3: run `pip install "gatetune[mitsuba]"`, '
            "or set scene.backend=raycast"
        ) from error
    mi.set_variant(VARIANT)
    mi.set_log_level(mi.LogLevel.Error)
    dr.set_thread_count(1)
    return mi


def _lunar(weight: Any, table: str) -> dict[str, Any]:
    """The table's reflectance times a texture: a blend with black, which Mitsuba picks by weight."""
    lunar = {"type": "twosided", "front": {"type": "measured", "filename": table}}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    return {"type": "blendbsdf", "weight": weight, "black": black, "lunar": lunar}


def _lunar_table() -> dict[str, NDArray[Any]]:
    """`lunar_reflectance` as Mitsuba's plugin ``measured`` reads it (Dupuy and Jakob 2018, isotropic).

    Reflectance over the half vector's ``u = (sqrt(theta 2 / pi), (phi + pi) / 2 pi)``, one table for each angle
    of the viewer; the density to draw from is the reflectance times the Jacobian from ``u`` to the direction.
    """
    u = np.linspace(0, 1, TABLE_SIZE)
    theta_i = np.linspace(0, np.pi / 2, TABLE_ANGLES)
    azimuth, polar = np.meshgrid((2 * u - 1) * np.pi, u**2 * np.pi / 2, indexing="ij")
    half = np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], -1)
    viewer = np.stack([np.sin(theta_i), np.zeros(TABLE_ANGLES), np.cos(theta_i)], -1)
    cosine = np.clip(np.einsum("pqk,tk->tpq", half, viewer), 0, 1)  # of half the phase angle
    mu0 = np.clip(2 * cosine * half[..., 2] - viewer[:, 2, None, None], 0, 1)
    mu = np.maximum(viewer[:, 2, None, None], 1e-3)
    value = lunar_reflectance(mu0, mu, np.degrees(2 * np.arccos(cosine))) / np.pi * (cosine > 0)
    density = value * np.maximum(2 * np.pi**2 * u * np.sin(polar), 1e-6) * 4 * cosine
    density += 1e-3 * density.max(axis=(1, 2), keepdims=True)  # no direction is impossible
    flat = np.ones((2, 2), np.float32)
    return {
        "description": np.frombuffer(b"lunar", np.uint8),
        "jacobian": np.zeros(1, np.uint8),
        "theta_i": theta_i.astype(np.float32),
        "phi_i": np.zeros(1, np.float32),
        "ndf": flat,
        "sigma": flat,
        "vndf": np.ones((1, TABLE_ANGLES, 2, 2), np.float32),
        "luminance": density[None].astype(np.float32),
        "rgb": np.repeat(value[None, :, None], 3, axis=2).astype(np.float32),
    }
