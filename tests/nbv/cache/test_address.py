"""What decides an address: inputs, the code with all that it imports, libraries."""

import ast
from pathlib import Path

import numpy as np
import pytest

import nbv
from nbv.cache import Store, address, code_digest, remember, remember_json
from nbv.cache.addressing import imported_modules

ROOT = Path(nbv.__file__).parent.parent
MAKERS = (
    "nbv.scene.bake",
    "nbv.geometric.world",
    "nbv.evaluation",
    "nbv.sparse.features",
    "nbv.photogrammetric",
)


def file_of(module):
    return ROOT.joinpath(*module.split(".")).with_suffix(".py")


def imports_in(module):
    """Dotted names of all of nbv that a module's source imports, found by parsing it."""
    for node in ast.walk(ast.parse(file_of(module).read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} has a relative import, which the address does not follow"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                is_module = file_of(inner).is_file() or file_of(inner).with_suffix("").is_dir()
                yield inner if is_module else node.module


@pytest.mark.parametrize("maker", MAKERS)
def test_every_import_of_the_code_is_in_its_digest(maker):
    found = imported_modules(maker)
    assert len(found) > 5
    for module in found:
        for name in imports_in(module):
            if name.startswith("nbv."):
                assert name in found or f"{name}.__init__" in found, f"{module} imports {name}"


def test_other_code_or_libraries_or_inputs_are_another_address(monkeypatch):
    first = address("nbv.geometry.sampling", 1)
    assert address("nbv.geometry.sampling", 1) == first
    others = [address("nbv.geometry.sampling", 2), address("nbv.geometry.neighbours", 1)]
    code_digest.cache_clear()
    monkeypatch.setattr("nbv.cache.addressing.versions", lambda: {"numpy": "0"})
    others.append(address("nbv.geometry.sampling", 1))
    code_digest.cache_clear()
    assert len({first, *others}) == 4


def test_what_was_made_is_read_back_and_a_stale_entry_is_not(tmp_path):
    store, made = Store(tmp_path), []

    def make():
        made.append(1)
        return {"i": np.arange(3)}

    for inputs in ([1], [1], [2]):
        entry = remember(store, "things", make, code="nbv.geometry", inputs=inputs)
        assert entry["i"].tolist() == [0, 1, 2]
    assert len(made) == 2
    remember(store, "things", make, code="nbv.scene", inputs=[1])
    assert len(made) == 3
    value = {"a": [1.5, None, "x"]}
    for _ in range(2):
        assert remember_json(store, "values", lambda: value, code="nbv.geometry", inputs=[]) == value
    assert [(kind.kind, kind.entries) for kind in store.info()] == [("things", 3), ("values", 1)]
