"""The rock as it stands in the scene: sunk into the ground, and cut off where the ground begins."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from nbv.config import GroundConfig, MissionConfig
from nbv.errors import UserError
from nbv.geometry.mesh import drop_unused_vertices
from nbv.rocks import Rock
from nbv.rocks.rock import make_rock
from nbv.terrain.relief import relief_of
from nbv.types import Floats, Ints


def buried_rock(rock: Rock, config: MissionConfig) -> Rock:
    """What of ``rock`` is above ground, ``ground.burial_m`` deeper than it was; the same object on bare flat ground.

    It is another rock, with a hash of its own: renderers, ground truth and oracles know nothing of the part below.

    `UserError` where ``burial_m`` hides the whole rock.
    """
    ground = config.ground
    if ground.burial_m == 0 and ground.relief_m == 0:
        return rock
    return _above_ground(rock, ground, config.scene.ground_seed)


@lru_cache(maxsize=16)  # as many as `nbv.rocks` holds; each by its identity
def _above_ground(rock: Rock, ground: GroundConfig, ground_seed: int) -> Rock:
    vertices = rock.vertices_m - [0.0, 0.0, ground.burial_m]
    relief = relief_of(ground, ground_seed)
    above_m = vertices[:, 2] - (0.0 if relief is None else relief.height_m(vertices))
    if above_m.max() <= 0:
        raise UserError(
            f"ground.burial_m is {ground.burial_m:g}: rock {rock.name!r} is only {np.ptp(rock.vertices_m[:, 2]):.2f} m high"
        )
    # Albedo rides along as three more coordinates.
    values, faces = _cut(np.concatenate([vertices, rock.albedo], axis=1), rock.faces, above_m)
    albedo = values[:, 3:].astype(np.float32)
    split, difficulty, notes = rock.split, rock.difficulty, rock.notes
    return make_rock(rock.name, values[:, :3], faces, albedo, split=split, difficulty=difficulty, notes=notes)


def _cut(values: Floats, faces: Ints, above: Floats) -> tuple[Floats, Ints]:
    """The part of a mesh where ``above`` (V,), linear within each face, is positive; ``values`` (V, C) ride along."""
    inside = above[faces] > 0
    count = inside.sum(axis=1)
    # Turned so that the one corner that differs from the other two comes first.
    odd = np.where(count == 1, inside.argmax(axis=1), inside.argmin(axis=1))
    turned = np.take_along_axis(faces, (odd[:, None] + np.arange(3)) % 3, axis=1)
    one, two = turned[count == 1], turned[count == 2]
    edges = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [0, 1]], two[:, [0, 2]]])
    unique, index = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    a, b = unique.T
    share = (above[a] / (above[a] - above[b]))[:, None]
    points = values[a] + share * (values[b] - values[a])
    p, q, r, s = np.split(len(values) + index.ravel(), np.cumsum([len(one), len(one), len(two)]))
    faces = np.concatenate(
        [
            faces[count == 3],
            np.stack([one[:, 0], p, q], axis=1),
            np.stack([r, two[:, 1], two[:, 2]], axis=1),
            np.stack([r, two[:, 2], s], axis=1),
        ]
    )
    values = np.concatenate([values, points])
    return drop_unused_vertices(values, faces)
