"""The store: whole entries or none, damage noticed, bounded, safe for several processes; and what decides an address."""

import multiprocessing
import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from nbv.cache import Store, cache_key, cached, cached_json, code_digest


def file_of(store, key, kind="*"):
    """The file that holds an entry."""
    (path,) = (path for path in store.root.glob(f"{kind}/**/{key}") if path.is_file())
    return path


@pytest.mark.parametrize("damage", ["flip", "truncate", "empty", "directory", "comment"])
def test_a_damaged_entry_is_noticed_and_can_be_made_anew(tmp_path, damage):
    store = Store(tmp_path)
    store.put("pairs", "cd34", {"m": np.arange(100)})
    path = file_of(store, "cd34")
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[len(data) // 2] ^= 1
    if damage == "directory":  # of no size: as if the archive had no members
        data[-10:-6] = bytes(4)
    if damage == "comment":  # an archive without members, and something behind its end
        data = bytearray(b"PK\5\6" + bytes(30))
    path.write_bytes(bytes(data[:-7] if damage == "truncate" else b"" if damage == "empty" else data))
    assert store.get("pairs", "cd34") is None
    assert not path.exists()
    store.put("pairs", "cd34", {"m": np.arange(100)})
    assert store.get("pairs", "cd34") is not None


def test_prune_drops_the_least_recently_used(tmp_path):
    store = Store(tmp_path)
    for index in range(4):
        store.put("photos", f"{index:02d}", {"i": np.zeros(1000)})
        os.utime(file_of(store, f"{index:02d}"), (index, index))
    store.get("photos", "00")  # used just now
    size = file_of(store, "00").stat().st_size
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


@pytest.mark.slow
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


def test_prune_removes_what_killed_processes_left(tmp_path):
    store = Store(tmp_path)
    store.put("photos", "ab", {"i": np.zeros(3)})
    new, old = (file_of(store, "ab").with_name(f".ab.{age}.tmp") for age in ("new", "old"))
    for path in (new, old):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    assert store.prune(10**6) == (0, 0)
    assert new.exists() and not old.exists()


def test_other_code_or_libraries_or_inputs_are_another_address(monkeypatch):
    first = cache_key("nbv.geometry.mesh", 1)
    assert cache_key("nbv.geometry.mesh", 1) == first
    others = [cache_key("nbv.geometry.mesh", 2), cache_key("nbv.geometry.visibility", 1)]
    code_digest.cache_clear()
    monkeypatch.setattr("nbv.cache.versions", lambda: {"numpy": "0"})
    others.append(cache_key("nbv.geometry.mesh", 1))
    code_digest.cache_clear()
    assert len({first, *others}) == 4


def test_what_was_made_is_read_back_and_a_stale_entry_is_not(tmp_path):
    store, made = Store(tmp_path), []

    def make():
        made.append(1)
        return {"i": np.arange(3)}

    for inputs in ([1], [1], [2]):
        entry = cached(store, "things", make, code="nbv.geometry", inputs=inputs)
        assert entry["i"].tolist() == [0, 1, 2]
    assert len(made) == 2
    cached(store, "things", make, code="nbv.scene", inputs=[1])
    assert len(made) == 3
    value = {"a": [1.5, None, "x"]}
    for _ in range(2):
        assert cached_json(store, "values", lambda: value, code="nbv.geometry", inputs=[]) == value
    assert Counter(path.parts[-3] for path in tmp_path.glob("*/??/*")) == {"things": 3, "values": 1}


def test_a_store_keeps_its_size_whoever_puts(tmp_path: Path) -> None:
    for number in range(60):
        Store(tmp_path, 200_000).put("kind", f"{number:04d}", {"a": np.zeros(20_000, np.uint8)})
    assert 100_000 < sum(path.stat().st_size for path in tmp_path.glob("*/??/*")) <= 200_000
