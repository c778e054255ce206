"""Where the camera may go: the seed rings (phase 1) and the two-band candidate pool (phase 2).

As in the authors' public code, a ring's azimuths are 360 k / n for k = 0 .. n - 1, measured from **north towards east**, so that
every ring has a viewpoint due north of the target; `Viewpoint.azimuth_deg` is the same direction in this project's convention,
counter-clockwise from east. A ring of 6 therefore is not the ring that one would get by counting from east.
"""

from nbv.viewpoints.pool import RINGS, ViewpointSource, candidate_pool
from nbv.viewpoints.rings import camera_shell, raw_candidates, seed_viewpoints

__all__ = [
    "RINGS",
    "ViewpointSource",
    "camera_shell",
    "candidate_pool",
    "raw_candidates",
    "seed_viewpoints",
]
