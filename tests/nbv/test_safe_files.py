"""Files from anybody: what is not as it must be is one line."""

import resource
from pathlib import Path

import gate_states
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nbv import safe_files
from nbv.errors import UserError
from nbv.mission.planning_state import load_state, save_state


@pytest.mark.parametrize(
    "text, says",
    [
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
    with pytest.raises(UserError) as caught:
        safe_files.parse_yaml(text, "it")
    assert says in str(caught.value) and len(str(caught.value).splitlines()) == 1


@given(st.text(alphabet="{}[]&*a:-!?|>'\"\n ,#%@1._", max_size=60))
def test_no_yaml_text_ends_in_another_error(text: str) -> None:
    try:
        safe_files.parse_yaml(text, "it")
    except UserError as error:
        assert "\n" not in str(error)


def test_yaml_repeats_what_stands_twice() -> None:
    assert safe_files.to_yaml({"a": (twice := {"x": 1}), "b": twice}) == "a:\n  x: 1\nb:\n  x: 1\n"


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


def test_a_planning_state_is_read_back_and_what_is_none_refused(tmp_path: Path) -> None:
    path = tmp_path / "iter_00.npz"
    state, pool = gate_states.state(), gate_states.pool()
    save_state(path, state, pool)
    found, candidates = load_state(path)
    assert np.array_equal(found.model.points_m, state.model.points_m) and candidates.ids == pool.ids
    assert (found.n_seeds, found.planned_views) == (state.n_seeds, state.planned_views)
    with np.load(path) as data:
        arrays = dict(data)
    for damage in ({"points_m": np.array([object()])}, {"scalars": None}):
        np.savez(path, **{name: a for name, a in {**arrays, **damage}.items() if a is not None})
        with pytest.raises(UserError, match=r"Object arrays|scalars"):
            load_state(path)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(UserError, match="damaged or of another kind"):
        load_state(path)
