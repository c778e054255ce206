"""Photographs in, aligned sparse models out (pycolmap)."""

import contextlib
import signal

import cv2  # noqa: F401  imported before pycolmap: the other order aborts the process when cv2 writes a PNG
import pycolmap

# What ends the process; errors are raised, and COLMAP would report every step on stderr.
pycolmap.logging.minloglevel = 3
# Its import takes SIGTERM and answers with a stack trace; who had it before gets it back. A thread may not.
if (_before := signal.getsignal(signal.SIGTERM)) is not None:
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGTERM, _before)
