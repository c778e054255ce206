"""One folder of rendered photographs of two cameras, imported once a session."""

from pathlib import Path

import pytest
from rendered_photographs import MAX_SIZE_PX, POSITIONS_M, render, save, silent

from nbv.cache import Store
from nbv.photographs.importer import ImportOptions, import_photographs

SMALLER = range(14, 20)  # those of the second camera


@pytest.fixture(scope="session")
def ball_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty photographs, the upper six by another camera, and a note that is no photograph."""
    folder = tmp_path_factory.mktemp("photographs") / "ball"
    folder.mkdir()
    for index, position in enumerate(POSITIONS_M):
        picture = render(position)
        more = {}
        if index in SMALLER:
            picture, more = picture.resize((384, 288)), {"device": "Small"}
        save(picture, folder / f"view_{index:02d}.jpg", index, position, **more)
    (folder / "notes.txt").write_text("a rock")
    return folder


@pytest.fixture(scope="session")
def ball_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return Store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="session")
def ball_set(ball_folder: Path, ball_store: Store, gatetune_home: Path):
    return import_photographs(
        ball_folder,
        "ball",
        ImportOptions(max_size_px=MAX_SIZE_PX),
        silent,
        ball_store,
    )
