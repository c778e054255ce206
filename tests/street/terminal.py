"""A terminal whose commands need not load their libraries: each is a process of its own, forked from one that has loaded them."""

import json
import os
import select
import subprocess
import sys
from importlib import import_module
from pathlib import Path

# What campaigns, their answers and their pages load.
LOADED = ("tuner.cli", "tuner.samplers.gp", "tuner.jobs", "tuner.report", "tuner.export", "matplotlib.pyplot")
TIMEOUT_S = 600.0


class Terminal:
    """The process that has loaded them; it ends with ours."""

    def __init__(self) -> None:
        pipe = subprocess.PIPE
        server = [sys.executable, __file__]
        environment = {**os.environ, "COLUMNS": "200", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._server = subprocess.Popen(server, stdin=pipe, stdout=pipe, text=True, env=environment)

    def run(
        self, words: list[str], folder: Path, environment: dict[str, str]
    ) -> subprocess.CompletedProcess[str]:
        """``gatetune WORDS`` in a folder, as from a shell."""
        said = {stream: folder / f".{stream}" for stream in ("stdout", "stderr")}
        asked = [words, str(folder), environment, *map(str, said.values())]
        assert self._server.stdin is not None and self._server.stdout is not None
        print(json.dumps(asked), file=self._server.stdin, flush=True)
        ready, _, _ = select.select([self._server.stdout], [], [], TIMEOUT_S)
        assert ready, f"gatetune {' '.join(words)} takes longer than {TIMEOUT_S:.0f} s"
        status = int(self._server.stdout.readline())
        return subprocess.CompletedProcess(words, status, *(path.read_text() for path in said.values()))


def serve() -> None:
    """Run what is asked for line by line; write the exit status of each."""
    for name in LOADED:
        import_module(name)
    for line in sys.stdin:
        child = os.fork()
        if not child:
            return become(*json.loads(line))
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    return None


def become(words: list[str], folder: str, environment: dict[str, str], stdout: str, stderr: str) -> None:
    """Be ``gatetune WORDS``, which ends the process."""
    for stream, number in ((os.devnull, 0), (stdout, 1), (stderr, 2)):
        os.dup2(os.open(stream, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
    os.chdir(folder)
    os.environ.update(environment)
    sys.argv, sys.path[0] = ["gatetune", *words], folder
    import_module("tuner.cli").main()


if __name__ == "__main__":
    serve()
