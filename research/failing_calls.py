"""System calls that fail: Linux asks this process about every writing call of another one and of all it starts.

A seccomp filter with user notification (seccomp_unotify(2), Linux 5.5, x86-64): the kernel holds the caller until it has an
answer, either "go on" or an error number, so that no program needs to be changed and compiled code is met as well.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import os
import platform
import socket
import struct
from collections.abc import Callable
from pathlib import Path

# Numbers of x86-64, and which argument is the file: a descriptor, or a path.
BY_DESCRIPTOR = {1: "write", 18: "pwrite64", 20: "writev", 74: "fsync", 75: "fdatasync", 77: "ftruncate"}
BY_PATH = {
    82: ("rename", 0),
    83: ("mkdir", 0),
    86: ("link", 1),
    87: ("unlink", 0),
    88: ("symlink", 1),
    257: ("openat", 1),
    258: ("mkdirat", 1),
    263: ("unlinkat", 1),
    264: ("renameat", 1),
    265: ("linkat", 3),
    266: ("symlinkat", 2),
    316: ("renameat2", 1),
}
OPENAT, WRITING = 257, os.O_WRONLY | os.O_RDWR | os.O_CREAT
ERRORS = (errno.ENOSPC, errno.EIO, errno.EROFS, errno.EDQUOT, errno.EACCES)
_RECEIVE, _SEND, _SECCOMP, _GO_ON = 0xC0502100, 0xC0182101, 317, 1
_ALLOW, _NOTIFY = 0x7FFF0000, 0x7FC00000


def possible() -> bool:
    """Whether this system can do it."""
    return platform.system() == "Linux" and platform.machine() == "x86_64"


def hold_calls(channel: socket.socket) -> None:
    """From now on this process asks before every writing call; the other end of ``channel`` answers, see `FailingCalls`."""

    def jump(code: int, value: int, yes: int, no: int) -> bytes:
        return struct.pack("HBBI", code, yes, no, value)

    numbers = [n for n in (*BY_DESCRIPTOR, *BY_PATH) if n != OPENAT]
    program = [jump(0x20, 0, 0, 0)]  # load the call's number
    program += [jump(0x15, n, len(numbers) - i + 3, 0) for i, n in enumerate(numbers)]  # one of them: notify
    program += [jump(0x15, OPENAT, 0, 2), jump(0x20, 16 + 2 * 8, 0, 0)]  # no openat: allow; load its flags
    program += [jump(0x45, WRITING, 1, 0), jump(0x06, _ALLOW, 0, 0), jump(0x06, _NOTIFY, 0, 0)]
    code = ctypes.create_string_buffer(b"".join(program))
    filter_ = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", len(program), ctypes.addressof(code)))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(38, 1, 0, 0, 0):  # PR_SET_NO_NEW_PRIVS
        raise OSError(ctypes.get_errno(), "no_new_privs")
    listener = libc.syscall(_SECCOMP, 1, 8, filter_)  # SET_MODE_FILTER, NEW_LISTENER
    if listener < 0:
        raise OSError(ctypes.get_errno(), "seccomp")
    socket.send_fds(channel, [b"x"], [listener])
    os.close(listener)


class FailingCalls:
    """Answers the calls below ``folder``; ``decide(pid, name, path)`` says with which error number, 0 for none."""

    def __init__(self, channel: socket.socket, folder: Path, decide: Callable[[int, str, str], int]) -> None:
        _, (self.listener,), _, _ = socket.recv_fds(channel, 1, 1)
        self._folder, self._decide = str(folder), decide

    def answer(self) -> None:
        """One call that waits."""
        asked = bytearray(80)
        with contextlib.suppress(OSError):  # the caller was killed meanwhile
            fcntl.ioctl(self.listener, _RECEIVE, asked)
            number, pid, _, call, _, _, *arguments = struct.unpack("QIIiIQ6Q", asked)
            name, path = self._file(pid, call, arguments)
            error = self._decide(pid, name, path) if path.startswith(self._folder) else 0
            answer = struct.pack("QqiI", number, 0, -error, 0 if error else _GO_ON)
            fcntl.ioctl(self.listener, _SEND, bytearray(answer))

    def close(self) -> None:
        """Calls that come from now on fail."""
        os.close(self.listener)

    def _file(self, pid: int, call: int, arguments: list[int]) -> tuple[str, str]:
        if call in BY_DESCRIPTOR:
            with contextlib.suppress(OSError):
                return BY_DESCRIPTOR[call], str(Path(f"/proc/{pid}/fd/{arguments[0]}").readlink())
            return BY_DESCRIPTOR[call], ""
        name, which = BY_PATH[call]
        with Path(f"/proc/{pid}/mem").open("rb", buffering=0) as memory:
            memory.seek(arguments[which])
            path = os.fsdecode(memory.read(4096).partition(b"\0")[0])
        with contextlib.suppress(OSError):  # a name in a folder that is open
            if which and not path.startswith("/") and "at" in name:
                path = str(Path(f"/proc/{pid}/fd/{arguments[which - 1]}").readlink() / path)
        return name, path
