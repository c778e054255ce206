"""Where the camera may go: the seed rings (phase 1) and the two-band candidate pool (phase 2).

Everything here is pure geometry. Both sets lie on spheres around the target: the seeds at
``seed.radius_m`` (4 m), the candidates at ``pool.radius_m`` (3.5 m). As in the authors' public code,
a ring's azimuths are 360 k / n for k = 0 .. n - 1, measured from **north towards east**, so that every
ring has a viewpoint due north of the target; `Viewpoint.azimuth_deg` is the same direction in this
project's convention, counter-clockwise from east. A ring of 6 therefore is not the ring that one
would get by counting from east.

With the paper's values the raw pool holds 170 candidates, ``cand_000`` to ``cand_169``: lateral rings of 58, 29, 19 and 14 at
10, 15, 25 and 35 degrees (1.408 to 2.807 m high), then upper ones of 17, 17 and 16 at 35, 45 and 55 degrees (to 3.667 m).
The spacing filter removes 7 upper candidates at 35 degrees, where both bands have a ring: 163 remain.
A minimum altitude of 1.5 m (the public code's) instead of 1.3 m also rejects the whole 10 degree
ring, the densest one: 105 remain.
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
