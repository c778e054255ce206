"""One tiny campaign on real photogrammetry, interrupted with Ctrl-C and resumed."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.slow

START = (
    "campaign run --name tiny --space gate --rock boulder --budget 4 --replicates 2 --workers 1 "
    "--set stop.adaptive_budget=1 --set evaluation.gt_samples=5000 --set dense.agreeing_views=3"
)
GATETUNE = [sys.executable, "-m", "tuner.cli"]


def gatetune(folder, *arguments):
    return subprocess.run(
        [*GATETUNE, *arguments], cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )


def finished(folder):
    return sorted(path.parent.name for path in (folder / "runs/tiny/missions").glob("*/mission.json"))


def test_interrupt_and_resume(tmp_path):
    process = subprocess.Popen(
        [*GATETUNE, *START.split()],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 400
    while not finished(tmp_path) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.5)
    os.kill(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130, out
    assert "gatetune campaign resume" in out
    before = finished(tmp_path)
    assert 1 <= len(before) < 4
    kept = (tmp_path / "runs/tiny/missions" / before[0] / "mission.json").read_text()

    status = gatetune(tmp_path, "campaign", "status", "runs/tiny")
    assert status.returncode == 0, status.stderr
    assert "of 4 missions" in status.stdout

    resumed = gatetune(tmp_path, "campaign", "resume", "runs/tiny", "--workers", "1")
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert len(finished(tmp_path)) >= 4  # trials that repeat photographs use no budget
    assert (tmp_path / "runs/tiny/missions" / before[0] / "mission.json").read_text() == kept  # not run again
    assert (tmp_path / "runs/tiny/report.html").stat().st_size > 10_000
    recommendation = json.loads((tmp_path / "runs/tiny/recommendation.json").read_text())
    assert recommendation["observations"] >= 4
    assert set(recommendation["values"]) == {"gate.budget_fraction", "gate.d95_m"}
