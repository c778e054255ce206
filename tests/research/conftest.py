"""Fixtures of the tests of research/."""

import pytest

from research.departures.__main__ import departures
from research.oracles.__main__ import oracle_states, oracles
from research.study_command import run
from research.transfer.__main__ import transfer
from tuner.commands import console

COMMANDS = {
    "departures": departures,
    "oracles": oracles,
    "oracle-states": oracle_states,
    "transfer": transfer,
}


@pytest.fixture
def study(monkeypatch, capfd, tmp_path):
    """Run a study's command in an empty working directory; returns (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    for shared in (console.output, console.errors):
        monkeypatch.setattr(shared, "width", 200)

    def call(name, *arguments):
        monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
        try:
            run(COMMANDS[name])
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        out, err = capfd.readouterr()
        return code, out, err

    return call
