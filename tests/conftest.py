"""What all tests share: a home of their own, and how workers share them out."""

import os

import pytest
from hypothesis import settings

# A busy machine is slow, not wrong: no property test may fail for the time an example takes.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A module's tests stay on one worker, which makes its fixtures once; the walks, which are long, go to whoever is free."""
    from xdist.scheduler import LoadFileScheduling

    class ByModule(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return nodeid if "test_walked.py" in nodeid else super()._split_scope(nodeid)

    config.option.loadscopereorder = False  # in the order of testpaths, the longest first
    return ByModule(config, log)


@pytest.fixture(scope="session", autouse=True)
def gatetune_home(tmp_path_factory):
    """Rocks of one worker's tests, none at their start: two workers make sets of photographs of one name.

    What is computed is kept in one store of all workers: a rock takes seconds.
    """
    home = tmp_path_factory.getbasetemp() / "gatetune-home"
    run = home.parent.parent if "PYTEST_XDIST_WORKER" in os.environ else home.parent
    (run / "store").mkdir(exist_ok=True)
    home.mkdir()
    (home / "store").symlink_to(run / "store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GATETUNE_HOME", str(home))
        yield home
