"""A few of the faults of `make faults`: nothing is lost, flown twice or charged, and nobody sees a traceback."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
KINDS = ("coordinator's writes from the Nth on",)


@pytest.mark.slow
def test_a_few_faults_do_no_harm(tmp_path: Path) -> None:
    asked = [part for kind in KINDS for part in ("--kind", kind)]
    command = [
        sys.executable,
        "-m",
        "research.faults",
        "--small",
        "--count",
        "4",
        *asked,
        "--out",
        str(tmp_path),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    *_, total = csv.DictReader((tmp_path / "faults.csv").open(newline=""))
    assert int(total["faults"]) >= 3
    for harm in ("traceback", "hang", "lost", "repeated", "charged"):
        assert total[harm] == "0", harm
