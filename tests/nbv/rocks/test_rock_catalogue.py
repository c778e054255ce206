"""Naming, keeping and finding rocks."""

import dataclasses

import numpy as np
import pytest
import trimesh
from refusals import refused

from nbv.cache import Store
from nbv.errors import UserError
from nbv.photographs.photograph_set import set_folder
from nbv.rocks import import_mesh, importer, list_rocks, load_rock, procedural, save_imported
from nbv.rocks.catalogue import LOADED, surface_path
from nbv.rocks.recipes import RECIPES


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """An empty folder for rocks, and coarse, quick procedural ones."""
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    surface = procedural._surface
    monkeypatch.setattr(procedural, "_surface", lambda recipe, grid_m: surface(recipe, 0.04))
    LOADED.clear()
    yield tmp_path / "home"
    LOADED.clear()


@pytest.fixture
def mesh_file(tmp_path, monkeypatch):
    path = tmp_path / "lump.stl"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    monkeypatch.setattr(importer, "MAX_EDGE_M", 0.05)
    return path


def test_a_procedural_rock_is_generated_once_and_read_back(home, monkeypatch):
    first = load_rock("waist", Store())
    assert load_rock("waist", Store()) is first  # in memory
    LOADED.clear()
    monkeypatch.setattr(procedural, "_surface", lambda *_: pytest.fail("generated twice"))
    again = load_rock("waist", Store())
    assert again.sha256 == first.sha256
    np.testing.assert_array_equal(again.vertices_m, first.vertices_m)
    np.testing.assert_array_equal(again.faces, first.faces)
    np.testing.assert_array_equal(again.albedo, first.albedo)
    assert (again.name, again.split, again.difficulty) == ("waist", first.split, first.difficulty)
    assert again.faces.dtype == first.faces.dtype and not again.vertices_m.flags.writeable
    assert [path.name for path in Store().root.iterdir()] == ["rocks"]


def test_nothing_is_overwritten_without_force(mesh_file):
    first = import_mesh(mesh_file, name="mine")
    save_imported(first)
    second = import_mesh(mesh_file, name="mine", height_m=1.0)
    refused("--force", save_imported, second)
    assert load_rock("mine").sha256 == first.sha256
    save_imported(second, force=True)
    assert load_rock("mine").sha256 == second.sha256


@pytest.mark.parametrize("name", ["../escape", "Upper", "", "a b", "-x", "x" * 80])
def test_unusable_names_are_refused(mesh_file, name):
    refused("cannot name a rock", save_imported, dataclasses.replace(import_mesh(mesh_file), name=name))


@pytest.mark.parametrize("name", ["boulder", "boulder-17", "overhang-20001", "cleft-007"])
def test_names_that_mean_something_else_are_refused(mesh_file, name):
    rock = import_mesh(mesh_file, name=name)
    for keep in (lambda: save_imported(rock, force=True), lambda: set_folder(name)):
        refused(r"already means a procedural rock.*choose another --name", keep)


def test_a_set_of_photographs_keeps_its_name(mesh_file):
    surface_path("mine").parent.mkdir(parents=True)
    surface_path("mine").touch()
    with pytest.raises(UserError, match="'mine' is the name of a set of photographs"):
        save_imported(import_mesh(mesh_file, name="mine"), force=True)


def test_unknown_rocks_are_refused_with_the_known_names():
    with pytest.raises(UserError) as caught:
        load_rock("bolder")
    assert "did you mean boulder" in str(caught.value) and "mushroom" in str(caught.value)
    for path in ("nowhere/rock.obj", "rock.obj"):
        refused("no mesh file", load_rock, path)


def test_damaged_imported_rock_is_refused(home, mesh_file, caplog):
    path = save_imported(import_mesh(mesh_file, name="mine"))
    path.write_bytes(path.read_bytes()[:1000])
    refused("import the rock again", load_rock, "mine")
    assert [rock.name for rock in list_rocks()] == list(RECIPES)
    assert "import it again" in caplog.text
