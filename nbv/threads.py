"""One mission, one thread: many missions run side by side in processes of their own."""

from __future__ import annotations

import os

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


def single_thread_environment() -> None:
    """Ask for one thread in every numerical library; call before they are imported."""
    for name, one in ONE_THREAD.items():
        os.environ.setdefault(name, one)


def limit_threads() -> None:
    """Hold libraries that are already loaded to one thread."""
    # cv2 before pycolmap: the other order lets libpng abort the process.
    import cv2  # noqa: PLC0415  after the environment is set
    from threadpoolctl import threadpool_limits  # noqa: PLC0415

    cv2.setNumThreads(1)
    threadpool_limits(1)
