"""Files from anybody: what is not as it must be is one line, at once, and in little memory."""

import io
import os
import zipfile
from pathlib import Path

import gate_states
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nbv import safe_files
from nbv.errors import UserError
from nbv.mission.planning_state import load_state, save_state

BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)
)


@pytest.mark.parametrize(
    "text, says",
    [
        (BOMB, "the number of nodes"),
        ("a: &a [*a]", "to itself"),
        ("a: *b", "alias"),
        ("[" * 100 + "]" * 100, "the depth is 41; the limit is 40 (GATETUNE_LIMITS=10 raises"),
        ("x: " + "1" * 5000, "not YAML"),
        ("x: 99999999999999999999", "beyond 64 bits"),
        ("base: {1: 2}", "it: the key 1 is not a text; quote it"),
        ('x: "\\ud800"', "Unicode"),
        ("x: !!python/object/apply:os.system [true]", "line 1: the tag !!python"),
        ("a: 1\na: 2", "duplicate key 'a'"),
        ("{[1]: 2}", "unhashable key"),
        ("\0", "not YAML"),
        ("x" * (safe_files.TEXT_BYTES + 1), "the size of it in characters"),
    ],
)
def test_yaml_beyond_its_limits_is_one_line(text: str, says: str) -> None:
    with pytest.raises(UserError) as caught:
        safe_files.parse_yaml(text, "it")
    assert says in str(caught.value) and len(str(caught.value).splitlines()) == 1


@given(st.text(alphabet="{}[]&*a:-!?|>'\"\n ,#%@1.", max_size=60))
def test_no_yaml_text_ends_in_another_error(text: str) -> None:
    try:
        safe_files.parse_yaml(text, "it")
    except UserError as error:
        assert "\n" not in str(error)


def test_yaml_repeats_what_stands_twice() -> None:
    assert safe_files.to_yaml({"a": (twice := {"x": 1}), "b": twice}) == "a:\n  x: 1\nb:\n  x: 1\n"


def test_only_regular_files_of_a_size_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="pipe is not a regular file"):
        safe_files.read_text(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "none", tmp_path / ("x" * 300), Path("a\0b"), Path("/dev/zero")):
        with pytest.raises(UserError):
            safe_files.read_bytes(path)
    (tmp_path / "large").write_bytes(bytes(11))
    with pytest.raises(UserError, match=r"in bytes is 11; the limit is 10 \(GATETUNE_LIMITS=10 raises"):
        safe_files.read_bytes(tmp_path / "large", 10)
    monkeypatch.setenv("GATETUNE_LIMITS", "2")
    assert len(safe_files.read_bytes(tmp_path / "large", 10)) == 11


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("state") / "iter_00.npz"
    save_state(path, gate_states.state(), gate_states.pool())
    return path


def changed(path: Path, saved: Path, **arrays: object) -> Path:
    """The saved state with other ``arrays``."""
    with np.load(saved) as data:
        np.savez_compressed(path, **{**data, **arrays})
    return path


def test_a_state_whose_arrays_do_not_fit_is_refused(saved: Path, tmp_path: Path) -> None:
    with np.load(saved) as data:
        good = dict(data)
    wrong: dict[str, object] = {
        "points_m": np.full_like(good["points_m"], np.nan),
        "track_cameras": good["track_cameras"] + 10**6,  # was read beyond an array's end
        "track_offsets": good["track_offsets"][::-1],
        "pool_positions_m": good["pool_positions_m"][:, :2],
        "camera_names": np.arange(len(good["camera_names"])),
        "visited_m": np.array([[object()]]),
        "scalars": np.full(6, np.inf),
        "pool_bands": good["pool_bands"][:0],
    }
    for name, array in wrong.items():
        with pytest.raises(UserError, match="Object arrays" if name == "visited_m" else name):
            load_state(changed(tmp_path / "state.npz", saved, **{name: array}))


def test_an_array_may_not_claim_more_than_it_holds(saved: Path, tmp_path: Path) -> None:
    header = io.BytesIO()
    shape = (10**12, 3)
    np.lib.format.write_array_header_1_0(header, {"shape": shape, "fortran_order": False, "descr": "<f8"})
    with (
        zipfile.ZipFile(saved) as source,
        zipfile.ZipFile(tmp_path / "state.npz", "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for name in source.namelist():
            target.writestr(name, header.getvalue() if name == "points_m.npy" else source.read(name))
    with pytest.raises(UserError, match=r"more memory than there is|damaged"):
        load_state(tmp_path / "state.npz")
