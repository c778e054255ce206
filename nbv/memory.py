"""Return freed memory to the operating system."""

from __future__ import annotations

import ctypes
import sys


def give_back_freed_memory() -> None:
    """Ask the C library to return what the process no longer uses; does nothing where it cannot.

    Glibc keeps freed blocks between others that are still in use. What one stage of a mission has left there, the
    next, with larger arrays, cannot use.
    """
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # absent in other C libraries, such as musl
    if trim is not None:
        trim(ctypes.c_size_t(0))
