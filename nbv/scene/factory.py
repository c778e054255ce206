"""From ``scene.backend`` to a renderer; the names stand in `nbv.config.registry`."""

from __future__ import annotations

from nbv.config import RENDERERS
from nbv.scene.bake import Scene
from nbv.scene.view import Renderer


def make_renderer(scene: Scene, backend: str) -> Renderer:
    """The renderer called ``backend``; ``UserError`` if there is none or it cannot run here."""
    renderer: Renderer = RENDERERS.load(backend)(scene)
    return renderer
