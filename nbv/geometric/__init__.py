"""The geometric fidelity, a low-fidelity simulator: missions without images, for screening configurations.

The planning code is the real one; image formation, structure from motion and dense reconstruction are
replaced by ray-cast visibility, simulated tracks and a predicted completeness. It ranks configurations;
its numbers are not those of a photogrammetric mission.
"""

from nbv.geometric.geometric_fidelity import run_geometric_mission

__all__ = ["run_geometric_mission"]
