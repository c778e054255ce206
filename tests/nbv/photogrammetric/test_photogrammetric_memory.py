"""What a mission that keeps only a summary lets go of before the stage that needs the most memory."""

import weakref

import numpy as np
import pytest

from nbv.cache import Store
from nbv.config import preset
from nbv.photogrammetric import reconstructor as photogrammetric
from nbv.photogrammetric.cached_sequences import CachedReconstructor, CachedSparse
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.types import PointCloud


class Still(CachedSparse):
    """A sparse stage that has nothing to do."""

    key = "a sequence"

    def __init__(self) -> None:
        self.poses = {"a": np.eye(4), "b": np.eye(4)}

    def bootstrap(self, captures):
        return None

    def refine(self):
        return None

    def world_camera_poses(self):
        return self.poses

    def export(self, directory, images):
        (directory / "exported").touch()


@pytest.mark.parametrize("cached", [False, True])
@pytest.mark.parametrize("keep_sparse", [False, True])
def test_only_a_mission_that_keeps_everything_holds_its_sparse_stage(
    monkeypatch, tmp_path, cached, keep_sparse
):
    alive, stages = [], []

    def check_depths(*arguments):
        alive.append(stages[0]() is not None)
        return photogrammetric.CheckedDepths(*[{}] * 6)

    def new_sparse(self, options):
        sparse = Still()
        stages.append(weakref.ref(sparse))
        return sparse

    monkeypatch.setattr(photogrammetric, "check_depths", check_depths)
    monkeypatch.setattr(photogrammetric.CheckedDepths, "fuse", lambda _: PointCloud(np.zeros((1, 3))))
    for kind in (PhotogrammetricReconstructor, CachedReconstructor):
        monkeypatch.setattr(kind, "_new_sparse", new_sparse)
    store = [Store(tmp_path / "store")] if cached else []
    kind = CachedReconstructor if cached else PhotogrammetricReconstructor
    reconstructor = kind(preset("campaign"), *store, keep_sparse=keep_sparse)
    reconstructor.bootstrap([])
    reconstructor._images = {"a": None, "b": None}
    assert len(reconstructor.finish().points_m) == 1
    assert alive == [keep_sparse]
    if keep_sparse:
        reconstructor.export_sparse(tmp_path, tmp_path)
        assert (tmp_path / "exported").exists()
    else:
        with pytest.raises(ValueError, match="keep_sparse"):
            reconstructor.export_sparse(tmp_path, tmp_path)
