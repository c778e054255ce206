"""Point clouds as PLY: what is written is read, also by viewers, and a damaged file is refused."""

import numpy as np
import pytest
import trimesh

from nbv.errors import UserError
from nbv.geometry.ply import read_ply, write_ply
from nbv.types import PointCloud

POINTS = np.random.default_rng(0).normal(size=(20, 3))
COLORS = np.arange(60, dtype=np.uint8).reshape(20, 3)


@pytest.mark.parametrize("colors", [None, COLORS], ids=["bare", "coloured"])
@pytest.mark.parametrize("normals", [None, POINTS[::-1]], ids=["flat", "oriented"])
def test_what_is_written_is_read(tmp_path, colors, normals):
    write_ply(tmp_path / "cloud.ply", PointCloud(POINTS, colors, normals), error=POINTS[:, 0])
    cloud, more = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.points_m, POINTS, rtol=1e-6)
    for back, given in ((cloud.colors, colors), (cloud.normals, normals)):
        assert (back is None) == (given is None)
        assert given is None or np.allclose(back, given)
    assert list(more) == ["error"] and np.allclose(more["error"], POINTS[:, 0])
    opened = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_allclose(opened.vertices, POINTS, rtol=1e-6)


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "cloud.ply"
    write_ply(path, PointCloud(POINTS))
    whole = path.read_bytes()
    for damaged in (
        b"",
        whole[:40],
        whole[:-5],
        whole[:-12],
        whole.replace(b"float y", b"float q"),
        whole[:-4] + b"\xff" * 4,
    ):
        path.write_bytes(damaged)
        with pytest.raises(UserError, match="make it again"):
            read_ply(path)
