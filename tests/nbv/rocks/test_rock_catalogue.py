"""Naming, keeping and finding rocks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from nbv.errors import UserError
from nbv.rocks import (
    catalogue,
    import_mesh,
    importer,
    list_rocks,
    load_rock,
    remove_imported,
    save_imported,
    store,
)
from nbv.rocks.procedural import generate_rock
from nbv.rocks.recipes import RECIPES


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """An empty folder for rocks, and coarse, quick procedural ones."""
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(catalogue, "generate_rock", lambda name: generate_rock(name, grid_m=0.04))
    forget()
    yield tmp_path / "home"
    forget()


def forget():
    """What a new process would not remember."""
    for loader in (catalogue._load_procedural, catalogue._load_imported, catalogue._load_file):
        loader.cache_clear()


@pytest.fixture
def mesh_file(tmp_path, monkeypatch):
    path = tmp_path / "lump.stl"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.05)
    return path


def test_procedural_rock_is_generated_once_and_read_back_identically(home, monkeypatch):
    first = load_rock("waist")
    forget()
    monkeypatch.setattr(catalogue, "generate_rock", lambda name: pytest.fail("generated twice"))
    again = load_rock("waist")
    assert again.sha256 == first.sha256
    np.testing.assert_array_equal(again.vertices_m, first.vertices_m)
    np.testing.assert_array_equal(again.faces, first.faces)
    np.testing.assert_array_equal(again.albedo, first.albedo)
    assert (again.split, again.difficulty) == (first.split, first.difficulty)


def test_cache_holds_one_version_of_a_rock(home, monkeypatch):
    load_rock("waist")
    load_rock("slab")
    forget()
    monkeypatch.setattr(catalogue, "generator_key", lambda: "0123456789abcdef")
    load_rock("waist")
    files = sorted(path.name for path in (home / "rocks" / "generated").iterdir())
    assert files[0].startswith("slab-") and files[1:] == ["waist-0123456789abcdef.npz"]


@pytest.mark.parametrize("damage", ["truncated", "flipped", "other file", "emptied"])
def test_damaged_cache_is_noticed_and_rebuilt(home, damage, caplog):
    good = load_rock("waist").sha256
    (file,) = (home / "rocks" / "generated").glob("waist-*.npz")
    content = bytearray(file.read_bytes())
    if damage == "truncated":
        file.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 2] ^= 0x55
        file.write_bytes(content)
    elif damage == "emptied":
        file.write_bytes(b"")
    else:
        file.write_bytes(b"not a rock at all")
    forget()
    assert load_rock("waist").sha256 == good
    assert "generating waist again" in caplog.text
    forget()
    assert store.read_rock(file).sha256 == good  # mended on disk
    assert not list(file.parent.glob("*.tmp"))


def test_altered_content_in_a_sound_file_is_noticed(home):
    rock = load_rock("waist")
    (file,) = (home / "rocks" / "generated").glob("waist-*.npz")
    forged = dataclasses.replace(rock, vertices_m=rock.vertices_m * 1.01)
    store.write_rock(forged, file)  # keeps the old hash
    with pytest.raises(store.DamagedRockError, match="content"):
        store.read_rock(file)


def test_unwritable_cache_does_not_stop_a_mission(tmp_path, monkeypatch, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder should be")
    monkeypatch.setenv("GATETUNE_HOME", str(blocked))
    assert load_rock("waist").name == "waist"
    assert "cannot cache" in caplog.text


def test_imported_rock_is_found_by_name(mesh_file):
    rock = import_mesh(mesh_file, name="my-rock", split="held-out", difficulty="round")
    save_imported(rock)
    assert load_rock("my-rock").sha256 == rock.sha256
    assert load_rock("my-rock").notes == rock.notes
    info = list_rocks()[-1]
    assert (info.name, info.split, info.source, info.difficulty) == (
        "my-rock", "held-out", "imported", "round",
    )  # fmt: skip
    remove_imported("my-rock")
    with pytest.raises(UserError, match="unknown rock"):
        load_rock("my-rock")


def test_nothing_is_overwritten_without_force(mesh_file):
    first = import_mesh(mesh_file, name="mine")
    save_imported(first)
    second = import_mesh(mesh_file, name="mine", height_m=1.0)
    with pytest.raises(UserError, match="--force"):
        save_imported(second)
    assert load_rock("mine").sha256 == first.sha256
    save_imported(second, force=True)
    assert load_rock("mine").sha256 == second.sha256
    with pytest.raises(UserError, match="procedural"):
        save_imported(import_mesh(mesh_file, name="boulder"), force=True)


@pytest.mark.parametrize("name", ["../escape", "Upper", "", "a b", "-x", "x" * 80])
def test_unusable_names_are_refused(mesh_file, name):
    with pytest.raises(UserError, match="cannot name a rock"):
        save_imported(dataclasses.replace(import_mesh(mesh_file), name=name))


def test_path_is_a_rock_too(mesh_file):
    assert load_rock(str(mesh_file)).sha256 == import_mesh(mesh_file).sha256


def test_unknown_rocks_are_refused_with_the_known_names():
    with pytest.raises(UserError) as caught:
        load_rock("bolder")
    assert "did you mean boulder" in str(caught.value) and "mushroom" in str(caught.value)
    for path in ("nowhere/rock.obj", "rock.obj"):
        with pytest.raises(UserError, match="no mesh file"):
            load_rock(path)


def test_damaged_imported_rock_is_refused(home, mesh_file, caplog):
    path = save_imported(import_mesh(mesh_file, name="mine"))
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(UserError, match="import the rock again"):
        load_rock("mine")
    assert [rock.name for rock in list_rocks()] == list(RECIPES)
    assert "import the rock again" in caplog.text


def test_splits_do_not_overlap():
    rocks = list_rocks()
    train = {rock.name for rock in rocks if rock.split == "train"}
    held_out = {rock.name for rock in rocks if rock.split == "held-out"}
    assert not train & held_out
    assert len(train) >= 5 and len(held_out) >= 12
    assert len({rock.name for rock in rocks}) == len(rocks)
