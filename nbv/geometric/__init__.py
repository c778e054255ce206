"""The geometric fidelity: missions without images, for screening configurations.

The planning code is the real one; image formation, structure from motion and dense reconstruction are
replaced by ray-cast visibility, simulated tracks and a predicted completeness. It ranks configurations;
its numbers are not those of a photogrammetric mission.
"""

from nbv.geometric.mission import predict_views, run_geometric_mission
from nbv.geometric.reconstructor import GeometricReconstructor, StandIn
from nbv.geometric.world import GeometricWorld, build_world, load_world

__all__ = [
    "GeometricReconstructor",
    "GeometricWorld",
    "StandIn",
    "build_world",
    "load_world",
    "predict_views",
    "run_geometric_mission",
]
