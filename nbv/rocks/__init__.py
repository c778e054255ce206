"""Rocks: procedural ones, imported meshes, and the catalogue with its train / held-out split."""

from nbv.rocks.catalogue import list_rocks, load_coarse_rock, load_rock, save_imported
from nbv.rocks.importer import import_mesh
from nbv.rocks.rock import DEFAULT_HEIGHT_M, Rock, describe

__all__ = [
    "DEFAULT_HEIGHT_M",
    "Rock",
    "describe",
    "import_mesh",
    "list_rocks",
    "load_coarse_rock",
    "load_rock",
    "save_imported",
]
