"""The store: whole entries or none, damage noticed, bounded, safe for several processes."""

import dataclasses
import multiprocessing

import numpy as np
import pytest

from nbv.cache import Store, digest
from nbv.config import CameraConfig, SparseConfig
from nbv.photogrammetric.cached_stages import STAGE_VERSION, CachedCorrespondences
from nbv.provenance import versions
from nbv.sparse.features import Features
from nbv.sparse.matching import VerifiedPair


def test_an_entry_comes_back_as_it_was(tmp_path):
    store = Store(tmp_path)
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "names": np.array(["x", "yy"])}
    store.put("features", "ab12", arrays)
    found = store.get("features", "ab12")
    assert found is not None
    assert set(found) == {"a", "names"}
    np.testing.assert_array_equal(found["a"], arrays["a"])
    assert found["a"].dtype == np.float32
    assert store.get("features", "ab13") is None


@pytest.mark.parametrize("damage", ["flip", "truncate", "empty"])
def test_a_damaged_entry_is_noticed_and_can_be_made_anew(tmp_path, damage):
    store = Store(tmp_path)
    store.put("pairs", "cd34", {"m": np.arange(100)})
    (path,) = [p for p in tmp_path.rglob("cd34") if p.is_file()]
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[-50] ^= 1
    path.write_bytes(bytes(data[:-7] if damage == "truncate" else b"" if damage == "empty" else data))
    assert store.get("pairs", "cd34") is None
    assert not path.exists()
    store.put("pairs", "cd34", {"m": np.arange(100)})
    assert store.get("pairs", "cd34") is not None


def test_verify_removes_only_the_damaged(tmp_path):
    store = Store(tmp_path)
    for index in range(5):
        store.put("photos", f"{index:02d}xx", {"i": np.array(index)})
    victim = store._path("photos", "03xx")
    victim.write_bytes(victim.read_bytes()[:-1])
    assert store.verify() == (5, 1)
    assert store.verify() == (4, 0)


def test_prune_drops_the_least_recently_used(tmp_path):
    import os

    store = Store(tmp_path)
    for index in range(4):
        store.put("photos", f"{index:02d}", {"i": np.zeros(1000)})
        os.utime(store._path("photos", f"{index:02d}"), (index, index))
    store.get("photos", "00")  # used just now
    size = store.info()[0].size_bytes // 4
    removed, freed = store.prune(2 * size)
    assert (removed, freed) == (2, 2 * size)
    assert store.get("photos", "00") is not None
    assert store.get("photos", "03") is not None
    assert store.get("photos", "01") is None


def _fill(root, repeats):
    store = Store(root)
    for _ in range(repeats):
        store.put("photos", "same", {"i": np.full(50_000, 7)})
        found = store.get("photos", "same")
        assert found is not None
        assert (found["i"] == 7).all()


def test_two_processes_may_fill_the_same_entry(tmp_path):
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_fill, args=(tmp_path, 40)) for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["same"]


def test_an_unwritable_store_costs_the_entry_not_the_result(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    store = Store(blocked / "store")
    store.put("photos", "ab", {"i": np.zeros(3)})
    assert not (blocked / "store").exists()


def test_digest_tells_values_shapes_and_types_apart():
    a = np.zeros((2, 3))
    keys = [
        digest(a),
        digest(a.T),
        digest(a.astype(np.float32)),
        digest("x", "y"),
        digest("xy"),
        digest(["x", "y"]),
    ]
    assert len(set(keys)) == len(keys)
    assert digest({"b": 1, "a": 2}) == digest({"a": 2, "b": 1})


def test_pairs_verified_with_other_trials_are_other_pairs_and_earlier_ones_stay_valid(tmp_path, monkeypatch):
    asked = []

    def verify(a, b, matches, camera, config):
        asked.append(config.min_ransac_trials)
        return VerifiedPair(np.zeros((20, 2), np.uint32), 2)

    monkeypatch.setattr("nbv.sparse.correspondences.verify_pair", verify)
    rng = np.random.default_rng(0)
    a, b = (Features(np.zeros((9, 4), np.float32), rng.integers(0, 99, (9, 128), np.uint8)) for _ in range(2))
    store, camera = Store(tmp_path / "store"), CameraConfig()
    for trials in (100, 30, 100, 30):
        CachedCorrespondences(camera, SparseConfig(min_ransac_trials=trials), store).pair(a, b)
    assert asked == [100, 30]
    # The key of a pair with COLMAP's number of trials is that of the time when there was no choice.
    options = SparseConfig()
    key = digest([STAGE_VERSION, versions()["pycolmap"], dataclasses.asdict(camera), options.match_ratio,
                  options.min_inliers], digest(a.keypoints, a.descriptors), digest(b.keypoints, b.descriptors))  # fmt: skip
    assert store.get("pairs", key) is not None
