"""A rock on lunar ground under the sun, photographed. Light is baked once; a frame is look-ups."""

from nbv.scene.bake import Scene, build_scene
from nbv.scene.factory import make_renderer
from nbv.scene.preview import preview
from nbv.scene.sensor import add_sensor_noise, noise_rng, photograph
from nbv.scene.view import RenderedView, Renderer

__all__ = [
    "RenderedView",
    "Renderer",
    "Scene",
    "add_sensor_noise",
    "build_scene",
    "make_renderer",
    "noise_rng",
    "photograph",
    "preview",
]
