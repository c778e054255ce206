"""Set up the environments of the peer optimisers: ``python -m research.peers.setup [ax] [smac] [hebo]``.

Each peer gets a virtual environment ``.peers/NAME`` of about 50 to 150 MB. Its site directory names the
project's environment in a ``.pth`` file, so torch and the numerical libraries are shared and not installed again;
the versions of constraints.txt hold. Run with the interpreter of the project's environment.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
# HEBO's own pins exclude every numpy that the project can run on; see requirements-hebo.txt.
WITHOUT_DEPENDENCIES = {"hebo": "HEBO==0.3.6"}
CHECKS = {"ax": "ax.api.client", "smac": "smac", "hebo": "hebo.optimizers.hebo"}


def run(command: list[str]) -> None:
    """Run a command and say what it was where it fails."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\nsetup: failed: {' '.join(command)}")


def set_up(name: str, directory: Path) -> None:
    """Make the environment of one peer, from nothing."""
    place = directory / name
    shutil.rmtree(place, ignore_errors=True)
    venv.create(place, with_pip=False, symlinks=os.name != "nt")
    python = place / "bin" / "python"
    site = place / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    (site / "project_environment.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "--quiet", "install"]
    requirements = str(HERE / f"requirements-{name}.txt")
    run([*pip, "-c", str(ROOT / "constraints.txt"), "-r", requirements])
    if name in WITHOUT_DEPENDENCIES:
        run([*pip, "--no-deps", WITHOUT_DEPENDENCIES[name]])
    run([str(python), "-c", f"import {CHECKS[name]}"])
    (place / ".ready").touch()
    print(f"setup: {name} is ready; research.optimiser_comparison finds it")


def main() -> None:
    """Parse and set up."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("peer", nargs="*", choices=[*CHECKS, []], help="default: all")
    parser.add_argument(
        "--directory", type=Path, default=Path(os.environ.get("GATETUNE_PEERS") or ROOT / ".peers")
    )
    arguments = parser.parse_args()
    try:
        import torch  # noqa: F401
    except ImportError:
        sys.exit("setup: run this with the interpreter of the project's environment; `make setup` makes it")
    arguments.directory.mkdir(parents=True, exist_ok=True)
    for name in arguments.peer or CHECKS:
        set_up(name, arguments.directory)


if __name__ == "__main__":
    main()
