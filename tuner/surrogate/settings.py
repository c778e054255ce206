"""What the surrogate is made of."""

from __future__ import annotations

from dataclasses import dataclass

# From so many parameters on most of them are expected to be without effect: 64 missions cannot tell which of 18
# matter otherwise.
MANY_PARAMETERS = 16


@dataclass(frozen=True)
class SurrogateSettings:
    """What the Gaussian process has beside the common landscape and the offsets."""

    own_landscapes: bool = False  # each rock departs from the common landscape, not only by an offset
    # SAAS prior of the length scales, and a linear trend. In ``full`` (18 parameters, 64 geometric missions) the recommendation is
    # worse by 0.25 points (0.06 to 0.49, five seeds) without both, and by 0.21 (0.04 to 0.41, seven seeds) without the trend.
    sparse: bool = False
