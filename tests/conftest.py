"""What all tests share: a home of their own."""

import os

import pytest
from hypothesis import settings

# A busy machine is slow, not wrong: no property test may fail for the time an example takes.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def gatetune_home(tmp_path_factory):
    """Rocks and caches of one test session, shared by its workers and empty at its start."""
    base = tmp_path_factory.getbasetemp()
    home = (base.parent if os.environ.get("PYTEST_XDIST_WORKER") else base) / "gatetune-home"
    before = os.environ.get("GATETUNE_HOME")
    os.environ["GATETUNE_HOME"] = str(home)
    yield home
    if before is None:
        os.environ.pop("GATETUNE_HOME")
    else:
        os.environ["GATETUNE_HOME"] = before
