"""The Dockerfile, which nobody builds in CI: what it copies and installs is what there is."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / ".ci" / "Dockerfile").read_text()


def test_what_it_copies_is_there_and_not_ignored() -> None:
    (copied,) = re.findall(r"^COPY (.*) \S+$", DOCKERFILE, re.M)
    kept = re.findall(r"^!(.*)$", (ROOT / ".ci" / "Dockerfile.dockerignore").read_text(), re.M)
    assert copied.split() == kept
    wheel = "python -m pip wheel --no-deps -w dist ."  # makes the one that is not in the repository
    assert wheel in DOCKERFILE and (ROOT / "constraints.txt").is_file()


def test_it_installs_the_libraries_that_the_setup_asks_for() -> None:
    (installed,) = re.findall(r"install -y --no-install-recommends (.*?)\\\s*&&", DOCKERFILE, re.S)
    asked = re.findall(r'"lib[^"]*\.so[^"]*": "([^"]+)"', (ROOT / ".ci" / "setup").read_text())
    assert asked and sorted(installed.split()) == sorted(asked)
