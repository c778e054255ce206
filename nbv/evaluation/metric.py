"""What a metric is, and what it is measured from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import EvaluationConfig
from nbv.types import Floats


@dataclass(frozen=True)
class Distances:
    """What a cloud's metrics on one surface are made from: S reference samples, N reconstructed points."""

    to_cloud_mm: Floats  # (S,) from each sample to the cloud: what is missing
    to_truth_mm: Floats  # (N,) from each point to the whole reference surface: what is wrong
    sectors: NDArray[np.int64]  # (S,) azimuth sector of each sample
    config: EvaluationConfig
    # Tanks and Temples' precision and recall (%) by threshold in mm, where wanted
    by_voxel: Mapping[float, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Metric:
    """One number of a mission's result, or one for each of ``evaluation.thresholds_mm``.

    Parameters
    ----------
    key
        Its name in the result; ``{t}`` stands for the threshold in mm.
    label
        Its name for people; may hold ``{t}``, too.
    unit
        Of the value: "%", "mm".
    larger_is_better
        Its direction.
    measure
        The value, from the distances and the threshold in mm (0 where the key has none).
    """

    key: str
    label: str
    unit: str
    larger_is_better: bool
    measure: Callable[[Distances, float], Any]
