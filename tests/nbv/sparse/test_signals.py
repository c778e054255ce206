"""COLMAP's import leaves SIGTERM to whom it belongs."""

import signal
import subprocess
import sys

import pytest

WAITS = """
import signal, sys
{before}
import nbv.sparse
print("ready", flush=True)
signal.pause()
"""


@pytest.mark.parametrize(
    ("before", "status"),
    [
        ("", -signal.SIGTERM),
        ("signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(7))", 7),
    ],
)
def test_a_termination_shows_no_stack_trace_and_reaches_its_handler(before, status):
    with subprocess.Popen(
        [sys.executable, "-c", WAITS.format(before=before)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as waiting:
        assert waiting.stdout is not None and waiting.stdout.readline() == "ready\n"
        waiting.terminate()
        _, said = waiting.communicate(timeout=60)
    assert (waiting.returncode, said) == (status, "")
