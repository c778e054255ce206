"""Ways to a port that can be held, so that nothing passes, or cut: ``python fault_network.py PORT COUNT``.

It prints the ways' own ports in a line, then does what its input says: ``hold N``, ``open N``, ``cut N``.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys


class Way:
    """Connections from one port to another."""

    def __init__(self, to: int) -> None:
        self._to = to
        self._passes = asyncio.Event()
        self._passes.set()
        self._ends: set[asyncio.StreamWriter] = set()

    async def begin(self) -> int:
        """The port of its own."""
        server = await asyncio.start_server(self._connect, "127.0.0.1", 0)
        port: int = server.sockets[0].getsockname()[1]
        return port

    def do(self, what: str) -> None:
        """Hold, open or cut it; what was cut may be connected anew."""
        if what == "hold":
            self._passes.clear()
        else:
            self._passes.set()
        if what == "cut":
            for end in self._ends:
                end.transport.abort()
            self._ends.clear()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there, theirs = await asyncio.open_connection("127.0.0.1", self._to)
        except OSError:
            writer.transport.abort()
            return
        self._ends |= {writer, theirs}
        await asyncio.gather(self._pass(reader, theirs), self._pass(there, writer))
        self._ends -= {writer, theirs}

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(1 << 16):
                await self._passes.wait()
                writer.write(data)
                await writer.drain()
        writer.close()


async def main(port: int, count: int) -> None:
    """Until its input ends."""
    ways = [Way(port) for _ in range(count)]
    print(*[await way.begin() for way in ways], flush=True)
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        what, number = line.split()
        ways[int(number)].do(what)


if __name__ == "__main__":
    asyncio.run(main(*map(int, sys.argv[1:])))
