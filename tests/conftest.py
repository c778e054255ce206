"""What all tests share: a home of their own."""

import pytest
from hypothesis import settings

# A busy machine is slow, not wrong: no property test may fail for the time an example takes.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def gatetune_home(tmp_path_factory):
    """Rocks and caches of one worker's tests, empty at their start: two workers make sets of photographs of one name."""
    home = tmp_path_factory.getbasetemp() / "gatetune-home"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GATETUNE_HOME", str(home))
        yield home
