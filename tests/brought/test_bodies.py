"""Meshes of several bodies: all are the target, or the one that is asked for; and the import lists them."""

import numpy as np
import pytest
import trimesh

from nbv.errors import UserError
from nbv.rocks import describe, import_mesh, importer

# The one of most surface is not the first in the file.
BODIES = [
    trimesh.creation.box(extents=(2, 1, 2)),
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).apply_translation((1.2, 0, 0)),
]


@pytest.fixture
def scan(tmp_path, monkeypatch):
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.3)
    trimesh.util.concatenate(BODIES[::-1]).export(tmp_path / "scan.ply")
    return tmp_path / "scan.ply"


@pytest.mark.parametrize(("body", "kept"), [(None, BODIES), (1, BODIES[:1]), (2, BODIES[1:])])
def test_all_bodies_are_the_target_or_one_is(scan, body, kept):
    rock, truth = import_mesh(scan, body=body), trimesh.util.concatenate(kept)
    scale = 1.6 / truth.extents[2]
    facts = describe(rock)
    np.testing.assert_allclose(facts["extents_m"], truth.extents * scale, atol=1e-3)
    assert facts["area_m2"] == pytest.approx(truth.area * scale**2, rel=1e-3)
    share = 100 * BODIES[0].area / sum(part.area for part in BODIES)
    [listed] = [note for note in rock.notes if note.startswith("2 bodies")]
    assert f"1: 2 x 1 x 2, {share:.1f} %" in listed and f"2: 1 x 1 x 1, {100 - share:.1f} %" in listed


def test_a_body_that_is_not_there(scan):
    for body, says in ((3, "has no body 3; it has 2"), (0, "the largest is 1")):
        with pytest.raises(UserError, match=says):
            import_mesh(scan, body=body)


def test_what_reaches_too_far_names_the_bodies(tmp_path):
    parts = [
        trimesh.creation.box(extents=(9, 9, 0.1)),
        trimesh.creation.box().apply_translation((0, 0, 0.55)),
    ]
    trimesh.util.concatenate(parts).export(tmp_path / "plate.ply")
    with pytest.raises(UserError, match=r"into the viewpoints.*--body N.*2: 1 x 1 x 1"):
        import_mesh(tmp_path / "plate.ply")
