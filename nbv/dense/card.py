"""The NVIDIA cards of this machine: one dense stage at a time on each, in a process of its own.

COLMAP ends the process where CUDA refuses something, and a card is busy with one mission: several at once gain nothing, and
may not fit into its memory.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nbv.errors import MissionFailure, UserError

DEVICES = Path("/dev")
_POLL_S = 0.2
_ON_CPU = "or go on without it: --set dense.backend=sgbm"
# What CUDA says, and what it means; the first that fits.
_REFUSALS = (
    (
        r"out of memory",
        "card_full",
        f"end what else runs on it, take smaller photographs (--set dense.max_size_px=480), {_ON_CPU}",
    ),
    (
        r"no kernel image|invalid device function|driver version|unsupported toolchain|PTX",
        "card_too_old",
        f"its driver or its generation is too old for pycolmap-cuda12: update the driver, {_ON_CPU}",
    ),
    (
        r"no CUDA-capable|No CUDA devices|num_cuda_devices|is lost|unavailable|launch failure|ECC|initialization",
        "card_lost",
        f"see whether `nvidia-smi` lists it, and repeat the command once it does, {_ON_CPU}",
    ),
)
_PATCH_MATCH = """
import json, sys
import pycolmap
options = pycolmap.PatchMatchOptions()
options.mergedict(json.loads(sys.argv[2]))
pycolmap.patch_match_stereo(sys.argv[1], options=options)
"""


def require_cuda() -> None:
    """`UserError` where the installed pycolmap has no CUDA."""
    import pycolmap  # noqa: PLC0415  half a second, wasted where no card is asked for

    if not pycolmap.has_cuda:
        raise UserError(
            'dense.backend=patchmatch needs a pycolmap with CUDA: run `pip install "gatetune[cuda]"` on a '
            "machine with an NVIDIA GPU, or set dense.backend=sgbm"
        )


@dataclass(frozen=True)
class Card:
    """One card, as CUDA counts them from 0, and as the driver names it."""

    index: int
    id: str

    @property
    def name(self) -> str:
        """Its model, where nvidia-smi says it."""
        known = ""
        if shutil.which("nvidia-smi"):
            command = ["nvidia-smi", "-i", self.id, "--query-gpu=name", "--format=csv,noheader"]
            with contextlib.suppress(OSError, subprocess.SubprocessError):
                answer = subprocess.run(command, capture_output=True, text=True, timeout=20)
                known = answer.stdout.strip().partition("\n")[0] if answer.returncode == 0 else ""
        return f"card {self.id}" + (f" ({known})" if known else "")


def cards() -> list[Card]:
    """Those that this process may use."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is None:
        numbers = (re.fullmatch(r"nvidia(\d+)", path.name) for path in DEVICES.glob("nvidia*"))
        ids = list(map(str, sorted(int(number[1]) for number in numbers if number)))
    else:
        ids = [card for name in chosen.split(",") if (card := name.strip())]
    return [Card(index, card) for index, card in enumerate(ids)]


@contextlib.contextmanager
def free_card() -> Iterator[Card]:
    """A card that no other mission of this user uses on this machine until the ``with`` ends; waits for one.

    `MissionFailure` where there is no card.
    """
    present = cards()
    if not present:
        raise MissionFailure("machine_error: card_lost", f"there is no NVIDIA card; {_REFUSALS[-1][2]}")
    with contextlib.ExitStack() as stack:
        folder = Path(tempfile.gettempdir())
        locks = [
            stack.enter_context((folder / f"gatetune-{os.getuid()}-card-{card.id}.lock").open("ab"))
            for card in present
        ]
        while True:
            for card, lock in zip(present, locks, strict=True):
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    yield card
                    return
            time.sleep(_POLL_S)


def patch_match(workspace: Path, options: Mapping[str, Any], card: Card) -> None:
    """COLMAP's PatchMatch on a workspace; `MissionFailure`, which names the card and the remedy, where CUDA refuses."""
    chosen = json.dumps({**options, "gpu_index": str(card.index)})
    # Numbered as the driver numbers them, and not the fastest first.
    ran = subprocess.run(
        [sys.executable, "-P", "-c", _PATCH_MATCH, str(workspace), chosen],
        env={**os.environ, "CUDA_DEVICE_ORDER": "PCI_BUS_ID"},
        capture_output=True,
        text=True,
        errors="replace",
    )
    if ran.returncode:
        raise refusal(card.name, ran.stderr, ran.returncode)


def refusal(name: str, said: str, status: int) -> MissionFailure:
    """What COLMAP's last words mean for the card called ``name``."""
    lines = re.findall(r"\[\w+\.\w+:\d+\] (.+)|CUDA error[^\n]* - (.+)|^(\w*Error: .+)", said, re.MULTILINE)
    words = next((" ".join(filter(None, line)) for line in reversed(lines)), f"it ended with status {status}")
    unknown = ("card_failed", f"see what `nvidia-smi` says of it, {_ON_CPU}")
    meant = (row[1:] for row in _REFUSALS if re.search(row[0], said, re.IGNORECASE))
    reason, remedy = next(meant, unknown)
    return MissionFailure(f"machine_error: {reason}", f"{name} refused PatchMatch: {words.strip()}; {remedy}")
