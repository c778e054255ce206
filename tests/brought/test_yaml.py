"""Values as users write them, and files from anybody: what is not as it must be is one line."""

import resource
from pathlib import Path

import gate_states
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from nbv import safe_files
from nbv.errors import UserError
from nbv.mission.planning_state import load_state, save_state
from nbv.safe_files import parse_yaml, to_yaml
from tuner.commands.console import parse_overrides

TEXTS = ["no", "yes", "on", "off", "y", "n", "No", "YES", "a_1", "12:30", "2001-09-09", "0b1", "=", ".5."]
VALUES = {
    "1e-6": 1e-6,
    "1E3": 1e3,
    "+.5e+2": 50.0,
    "5.": 5.0,
    "-.inf": float("-inf"),
    "010": 10,
    "0o10": 8,
    "0x1F": 31,
    "+5": 5,
    "True": True,
    "FALSE": False,
    "~": None,
    "Null": None,
    "'1e-6'": "1e-6",
    "<<": "<<",
    "'1_000'": "1_000",
}
REFUSED = {
    "a: !!binary aGk=": "line 1: the tag !!binary is not read; give a plain value without it",
    "a: 1\nb: !!timestamp 2001-01-01": "line 2: the tag !!timestamp is not read",
    "a: !!python/object:os.system x": "the tag !!python/object:os.system is not read",
    "a: !mine 3": "the tag !mine is not read",
    "a: 1_0": "line 1: 1_0 is a number in YAML 1.1 and a text in 1.2; write 10, or quote it",
    "a: [2, -1_000.5]": "write -1000.5, or quote it",
    "<<: 3": "line 1: the key << takes in another mapping (<<: *NAME), and no mapping follows",
}


@pytest.mark.parametrize("text, value", [*VALUES.items(), *zip(TEXTS, TEXTS)])
def test_a_plain_value_is_what_yaml_1_2_says(text: str, value: object) -> None:
    for read in (
        parse_yaml(f"a: {text}", "it")["a"],
        parse_yaml(f"[{text}]", "it")[0],
        parse_overrides([f"a={text}"])["a"],
    ):
        assert read == value and type(read) is type(value)


@given(
    st.recursive(
        st.sampled_from([*VALUES, *VALUES.values(), *TEXTS])
        | st.floats(allow_nan=False)
        | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(TEXTS), inner, max_size=3)
        ),
        max_leaves=6,
    )
)
def test_what_is_written_reads_back_by_either_version(tree: object) -> None:
    assert parse_yaml(to_yaml(tree), "it") == yaml.safe_load(to_yaml(tree)) == tree
    assert parse_yaml("base: &b {x: 1}\na: {<<: *b, y: 2}", "it")["a"] == {"x": 1, "y": 2}


@pytest.mark.parametrize(
    "text, says",
    [
        *REFUSED.items(),
        ("a: &a [*a]", "recursive"),
        ("a: *b", "alias"),
        ("[" * 100_000, "the depth is 41; the limit is 40 (GATETUNE_LIMITS=10 raises"),
        ("x: " + "1" * 5000, "not YAML"),
        ("x: 99999999999999999999", "beyond 64 bits"),
        ("base: {1: 2}", "it line 1: the key 1 is not a text; quote it"),
        ('x: "\\ud800"', "Unicode"),
        ("x: !!python/object/apply:os.system [true]", "line 1: the tag !!python"),
        ("x: !!bool y", "not YAML"),
        ("a: 1\na: 2", "line 2: duplicate key 'a'"),
        ("{[1]: 2}", "the key [1] is not a text"),
        ("\0", "not YAML"),
        ("x" * (safe_files.TEXT_BYTES + 1), "the size of it in characters"),
    ],
)
def test_yaml_that_is_not_read_is_one_line(text: str, says: str) -> None:
    assert says in refused(".", parse_yaml, text, "it")


def test_only_files_of_a_size_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in (tmp_path, tmp_path / "none", tmp_path / ("x" * 300), Path("a\0b")):
        with pytest.raises(UserError):
            safe_files.read_bytes(path)
    (tmp_path / "large").write_bytes(bytes(11))
    with pytest.raises(UserError, match=r"in bytes is 11; the limit is 10 \(GATETUNE_LIMITS=10 raises"):
        safe_files.read_bytes(tmp_path / "large", 10)
    monkeypatch.setenv("GATETUNE_LIMITS", "2")
    assert len(safe_files.read_bytes(tmp_path / "large", 10)) == 11


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "page"
    safe_files.write_atomic(path, "old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            safe_files.write_atomic(path, "new" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("page", "old")]


def test_a_file_that_a_compiled_library_could_not_end_is_noticed(tmp_path: Path) -> None:
    path, limits = tmp_path / "points3D.bin", resource.getrlimit(resource.RLIMIT_FSIZE)
    path.write_bytes(bytes(8192))
    safe_files.require_whole(path)
    assert path.stat().st_size == 8192
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            safe_files.require_whole(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_what_is_no_planning_state_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "iter_00.npz"
    save_state(path, gate_states.state(), gate_states.pool())
    with np.load(path) as data:
        arrays = dict(data)
    for damage in ({"points_m": np.array([object()])}, {"scalars": None}):
        np.savez(path, **{name: a for name, a in {**arrays, **damage}.items() if a is not None})
        refused(r"Object arrays|scalars", load_state, path)
    path.write_bytes(path.read_bytes()[:500])
    refused("damaged or of another kind", load_state, path)
