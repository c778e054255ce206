"""The machine's check, and the version."""

from importlib import metadata

import pytest

from tuner.commands import doctor


def test_this_machine_can_fly(gatetune):
    code, out, err = gatetune("doctor")
    assert code == 0, out + err
    assert out.splitlines()[-1] == "missions can be flown here"
    assert "BAD" not in out and "Python 3" in out and "store holds" in out


def test_a_library_that_does_not_load_is_bad(monkeypatch):
    monkeypatch.setattr(doctor, "_LIBRARIES", ("no_such_library",))
    first = next(doctor.libraries())
    assert first.verdict == "bad" and "no_such_library" in first.what and first.remedy == "make setup"


@pytest.mark.parametrize("word", ["--version"])
def test_the_version(gatetune, word):
    code, out, _ = gatetune(word)
    assert code == 0 and out.strip() == f"gatetune {metadata.version('gatetune')}"
