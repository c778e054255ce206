"""From a backend's name to a renderer."""

from __future__ import annotations

from nbv.errors import UserError
from nbv.scene.bake import Scene
from nbv.scene.view import Renderer

BACKENDS = ("raycast", "gl")


def make_renderer(scene: Scene, backend: str) -> Renderer:
    """The renderer called ``backend``; ``UserError`` if there is none or it cannot run here."""
    if backend == "raycast":
        from nbv.scene.raycast import RaycastRenderer

        return RaycastRenderer(scene)
    if backend == "gl":
        from nbv.scene.gl import GLRenderer  # imports OpenGL only when it is asked for

        return GLRenderer(scene)
    raise UserError(f"scene.backend is {backend!r}; there are {', '.join(BACKENDS)}")
