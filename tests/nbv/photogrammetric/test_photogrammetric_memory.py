"""What a mission that keeps only a summary lets go of before the stage that needs the most memory."""

import weakref

import numpy as np
import pytest

from nbv.cache import Store
from nbv.config import preset
from nbv.photogrammetric import reconstructor as photogrammetric
from nbv.photogrammetric.reconstructor import PhotogrammetricReconstructor
from nbv.sparse.features import Features
from nbv.sparse.matching import VerifiedPair
from nbv.sparse.reconstructor import SparseReconstructor
from nbv.types import Capture, PointCloud, SparseModel, UpdateReport, Viewpoint

REPORT = UpdateReport(
    SparseModel(
        np.zeros((1, 3)), np.zeros(1), np.zeros(2, int), np.zeros(0, int), np.zeros((1, 3)), ("a",), 0, 0
    ),
    True,
    "",
)


class NoMapping(SparseReconstructor):
    """Takes features and pairs from its source as the real one does, then stands still."""

    def bootstrap(self, captures):
        for capture in captures:
            features = self._source.features(capture.image)
            self._features.append(features)
            self._model.add_image(capture.name, features.keypoints)
        self._model.add_pairs({(1, 2): self._source.pair(*self._features)})
        return REPORT

    def refine(self):
        return REPORT

    def save_state(self, path):
        (path / "state").write_bytes(b"")

    def world_camera_poses(self):
        return {"a": np.eye(4), "b": np.eye(4)}

    def export(self, path):
        (path / "exported").touch()


class Dense:
    """Stands for both dense stages; notes what of the sparse stage is alive while they work."""

    def __init__(self):
        self.watched, self.alive = [], []

    def check_depths(self, images, poses, *rest):
        self.alive.append([ref() is not None for ref in self.watched])
        return self

    def fuse(self, agreeing_views):
        self.alive.append([ref() is not None for ref in self.watched])
        return PointCloud(np.zeros((1, 3)))


@pytest.fixture
def dense(monkeypatch):
    dense = Dense()

    def features(image, config):
        found = Features(np.zeros((20, 4), np.float32), np.zeros((20, 128), np.uint8))
        dense.watched.append(weakref.ref(found.descriptors))
        return found

    def verify(*arguments):
        pair = VerifiedPair(np.zeros((20, 2), np.uint32), 2)
        dense.watched.append(weakref.ref(pair.matches))
        return pair

    def mapping(*arguments):
        model = NoMapping(*arguments)
        dense.watched.append(weakref.ref(model))
        return model

    monkeypatch.setattr(photogrammetric, "check_depths", dense.check_depths)
    monkeypatch.setattr(photogrammetric, "SparseReconstructor", mapping)
    monkeypatch.setattr("nbv.sparse.correspondences.extract_features", features)
    monkeypatch.setattr("nbv.sparse.correspondences.verify_pair", verify)
    return dense


def fly(dense, store, *, keep_sparse):
    config = preset("campaign")
    reconstructor = PhotogrammetricReconstructor(config, store, keep_sparse=keep_sparse)
    size = (config.camera.height_px, config.camera.width_px, 3)
    place = Viewpoint("seed_00", (3.0, 0.0, 1.0), 0.0, 0.0, "seed")
    captures = [
        Capture(name, place, np.eye(4), np.full(size, i, np.uint8)) for i, name in enumerate(("a", "b"))
    ]
    reconstructor.bootstrap(captures)
    reconstructor.finish()
    return reconstructor


@pytest.mark.parametrize("cached", [False, True])
def test_a_summary_mission_frees_its_sparse_data_before_dense(dense, tmp_path, cached):
    reconstructor = fly(dense, Store(tmp_path / "store") if cached else None, keep_sparse=False)
    assert len(dense.watched) == 4  # two photographs' features, their matches, the model
    assert dense.alive == [[False] * 4] * 2
    with pytest.raises(ValueError, match="keep_sparse"):
        reconstructor.export_sparse(tmp_path)


@pytest.mark.parametrize("cached", [False, True])
def test_a_mission_that_keeps_everything_can_export_the_model(dense, tmp_path, cached):
    reconstructor = fly(dense, Store(tmp_path / "store") if cached else None, keep_sparse=True)
    assert dense.alive == [[True] * 4] * 2
    reconstructor.export_sparse(tmp_path)
    assert (tmp_path / "exported").exists()
