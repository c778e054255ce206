"""A rock on lunar ground under the sun, photographed. Light is baked once, a frame is look-ups; or it is traced."""

from nbv.scene.bake import Scene, build_scene
from nbv.scene.sensor import Sensor
from nbv.scene.view import Renderer, make_renderer, preview

__all__ = ["Renderer", "Scene", "Sensor", "build_scene", "make_renderer", "preview"]
