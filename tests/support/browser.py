"""A page opened in headless Chromium: what its console says, and whether it is wider than the window."""

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
# A frame each, for Chromium makes no window as narrow as a telephone.
_FRAME = '<iframe src="page.html" width="{}" height="1500" style="border:0"></iframe>'
_MEASURE = (
    "<script>addEventListener('load', () => setTimeout(() => "
    "console.log('WIDTHS', innerWidth, document.documentElement.scrollWidth), 200))</script>"
)
_OPTIONS = ["--headless", "--no-sandbox", "--enable-logging=stderr", "--virtual-time-budget=10000"]
_GRAPHICS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def opened(page: str, widths: tuple[int, ...]) -> tuple[list[str], dict[int, int]]:
    """What the console says of the page's source, and by each width of a window the width of what is in it."""
    for _ in range(3):  # on a busy machine Chromium may end before a frame's timer
        said, needed = _opened_once(page, widths)
        if set(needed) == set(widths):
            break
    return said, needed


def _opened_once(page: str, widths: tuple[int, ...]) -> tuple[list[str], dict[int, int]]:
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        (Path(folder) / "page.html").write_text(page + _MEASURE)
        frames = Path(folder) / "frames.html"
        frames.write_text("".join(_FRAME.format(width) for width in widths))
        command = [CHROMIUM, *_OPTIONS, *_GRAPHICS, f"--user-data-dir={folder}/profile", "--dump-dom"]
        log = subprocess.run(
            [*command, frames.as_uri()], capture_output=True, text=True, timeout=300, check=True
        ).stderr
    said = re.findall(r'CONSOLE:\d+\] "(.*?)", source', log, re.DOTALL)
    found = [re.fullmatch(r"WIDTHS (\d+) (\d+)", line) for line in said]
    needed = {int(m[1]): int(m[2]) for m in found if m}
    return [line for line, m in zip(said, found, strict=True) if not m], needed
