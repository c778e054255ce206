"""Photographs in, aligned sparse models out (pycolmap)."""

import cv2  # noqa: F401  imported before pycolmap: the other order aborts the process when cv2 writes a PNG
import pycolmap

# What ends the process; errors are raised, and COLMAP would report every step on stderr.
pycolmap.logging.minloglevel = 3

from nbv.sparse.reconstructor import SparseReconstructor  # noqa: E402  after the log level is set

__all__ = ["SparseReconstructor"]
