"""Which renderer a configuration names."""

from __future__ import annotations

from collections.abc import Callable

from nbv.config import RENDERERS
from nbv.scene.bake import Scene
from nbv.scene.gl import GLRenderer
from nbv.scene.raycast import RaycastRenderer
from nbv.scene.view import Renderer

BUILT_IN: dict[str, Callable[[Scene], Renderer]] = {"raycast": RaycastRenderer, "gl": GLRenderer}


def make_renderer(scene: Scene, backend: str) -> Renderer:
    """The renderer called ``backend``; ``UserError`` if there is none or it cannot run here."""
    renderer: Renderer = RENDERERS.load(backend, BUILT_IN)(scene)
    return renderer
