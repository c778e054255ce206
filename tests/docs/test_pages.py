"""The documentation is current and complete; its pictures are not older than what they show."""

import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from PIL import Image

from tuner.cli import app

ROOT = Path(__file__).resolve().parent.parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = [ROOT / "README.md", *PAGES]
# A page of results may name options of the commit that it was measured at.
GUIDES = [page for page in TEXTS if "results" not in page.parts]


@pytest.mark.parametrize("page", GUIDES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_on_a_page_exist_with_their_options(page):
    for line in command_lines(page.read_text()):
        words = shlex.split(line, comments=True)
        if words[:2] == ["python", "-m"]:
            module = ROOT / words[2].replace(".", "/")
            assert module.is_dir() or module.with_suffix(".py").is_file(), line
            continue
        if words[0] == "python":
            assert (ROOT / words[1]).is_file(), line
            continue
        command = typer.main.get_command(app)
        for word in words[1:]:
            if word not in getattr(command, "commands", {}):
                break
            command = command.commands[word]
        assert not hasattr(command, "commands"), f"{line}: names no command"
        known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)} | {"--help"}
        unknown = {w.split("=")[0] for w in words if w.startswith("--")} - known
        assert not unknown, f"{line}: {unknown}"


def command_lines(text: str) -> list[str]:
    """Indented or fenced lines that call gatetune or one of our scripts, continued lines joined."""
    joined = re.sub(r"\\\n\s*", "", text)
    lines = [line.strip() for line in joined.splitlines()]
    lines = [re.sub(r"^([A-Z_]+=\S* )+", "", line) for line in lines]
    return [line for line in lines if re.match(r"gatetune [a-z]|python (-m research\.|docs/)", line)]


def test_pages_made_from_the_code_are_current():
    check = [sys.executable, str(DOCS / "make_pages.py"), "--check"]
    found = subprocess.run(check, cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr + "run python docs/make_pages.py"


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    """A dead link, a missing anchor and a page that no menu leads to are warnings."""
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    found = subprocess.run(build, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr


SCREENSHOTS = runpy.run_path(str(ROOT / "docs" / "make_screenshots.py"))


@pytest.mark.parametrize("name", SCREENSHOTS["MADE_FROM"])
def test_pictures_show_what_is_there(name: str) -> None:
    with Image.open(ROOT / "docs" / "images" / f"{name}.png") as picture:
        held = picture.info.get(SCREENSHOTS["DIGEST"])
    assert held == SCREENSHOTS["digest"](name), (
        "run python docs/make_screenshots.py and look at the pictures; or, where it does not show, with --same"
    )
