"""A user at a terminal: every command of a page, or of a screen, in its order, on what the one before left."""

import functools
import html
import os
import re
import shlex
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import typer
from terminal import Terminal

from tuner.cli import app

ROOT = Path(__file__).resolve().parent.parent.parent
# What makes a command quick enough for a test: it keeps its own options, and the last of an option given twice counts.
ROCKS = {  # of a command that names none and would make many: a rock takes seconds
    "evaluate": ["--rock", "arch"],
    "campaign": ["--rock", "slab"],
}
SMALL = {"fidelity": "geometric", "budget": "6", "replicates": "1", "workers": "1"}
# A mission with photographs: 15 + 1, with a dense stage at a quarter of the pixels.
FEW = "photographs=16 seeds=15 seed.layout=turn sparse.ground_features=2000 dense.max_size_px=320"


@dataclass
class Street:
    """A folder and the command line in it; ``GATETUNE`` names another installation's command, such as a wheel's."""

    folder: Path
    small: dict[str, str] = field(default_factory=lambda: dict(SMALL))

    def run(self, line: str) -> str:
        """Run ``gatetune ...`` as printed, made quick; its output. Another exit status than 0 fails the test."""
        words = _with_few_rocks(shlex.split(line, comments=True)[1:])
        run = typed([*words, *self._quick(words)], self.folder, self._home())
        said = run.stdout + run.stderr
        assert run.returncode == 0 and "Traceback" not in said, f"{line}\nexit {run.returncode}\n{said}"
        return run.stdout

    def _home(self) -> Path:
        """A folder of its own, for two pages may both call a rock ``mine``; what is computed is shared by all."""
        shared = Path(os.environ["GATETUNE_HOME"])
        home = self.folder / ".gatetune"
        if not home.exists():
            home.mkdir()
            (shared / "store").mkdir(parents=True, exist_ok=True)
            (home / "store").symlink_to(shared / "store")
        return home

    def _quick(self, words: list[str]) -> list[str]:
        """Options that make a command small: those that it knows and that the page does not need to be what they are."""
        known = options(words) - ({"fidelity"} if "resume" in words else set())
        small = SMALL if {"--learn-from", "runs/tune/campaign.yaml"} & set(words) else self.small
        quick = [w for name, value in small.items() if name in known for w in (f"--{name}", value)]
        if "--quick" in words:  # in its dim hall not every mission on every rock succeeds
            quick += ["--compare-on", "arch"]
        elif "rock" in known and not {"--rock", "resume", "runs/tune/campaign.yaml"} & set(words):
            quick += ROCKS.get(words[0], [])
        if words[0] == "reproduce":
            quick += ["--strategy", "hyb-h", "--strategy", "covis"]
        if words[:2] == ["mission", "run"]:
            quick += [word for value in FEW.split() for word in ("--set", value)]
        return quick

    def file(self, path: str) -> str:
        """The text of a file that a command left."""
        return (self.folder / path).read_text()


def _with_few_rocks(words: list[str]) -> list[str]:
    """A command with the first of several rocks that it names: making one takes seconds."""
    left_out = set[int]()
    for option in ("--rock", "--compare-on"):
        _, *others = [i for i, word in enumerate(words) if word == option] or [0]
        left_out |= {j for i in others for j in (i, i + 1)}
    return [word for i, word in enumerate(words) if i not in left_out]


def typed(words: list[str], folder: Path, home: Path) -> subprocess.CompletedProcess[str]:
    """A command line, run in a folder: by the program that ``GATETUNE`` names, else by this one."""
    environment = {"COLUMNS": "200", "GATETUNE_HOME": str(home)}
    if program := os.environ.get("GATETUNE"):
        return subprocess.run(
            [program, *words],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
            env=os.environ | environment,
        )
    return terminal().run(words, folder, environment)


terminal = functools.cache(Terminal)  # one of all tests


def options(words: list[str]) -> set[str]:
    """Names of the options that a command knows."""
    command = typer.main.get_command(app)
    for word in words:
        if word not in getattr(command, "commands", {}):
            break
        command = command.commands[word]
    return {name.removeprefix("--") for p in command.params for name in p.opts}


def commands_of(page: Path) -> list[str]:
    """What a page of the documentation tells its reader to type, in its order."""
    joined = re.sub(r"\\\n\s*", " ", page.read_text())
    lines = re.findall(
        r"^ {4}(gatetune [a-z].*?)(?: +#.*)?$|`(gatetune [a-z-]+ [^`]+)`", joined, re.MULTILINE
    )
    return [block or inline for block, inline in lines]


def commands_on(screen: str) -> list[str]:
    """What a screen or a page in HTML tells its reader to type; words in capitals are for the reader to fill in."""
    text = html.unescape(re.sub(r"<(script|style).*?</\1>", "", screen, flags=re.DOTALL))
    text = re.sub(r"<(?!/?code|/?pre)[^>]*>", "", text)
    found = re.findall(r"<(?:code|pre)[^>]*>\s*(gatetune [^<]+?)\s*</", text)
    found += re.findall(r"^\s*(gatetune [a-z].*?)\s*$", re.sub(r"<[^>]*>", "\n", text), re.MULTILINE)
    return list(dict.fromkeys(found))
