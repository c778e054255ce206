"""How slanted a surface may be seen: largest angles between its normal and the line of sight, one per question."""

MATCHABLE_MAX_INCIDENCE_DEG = 75.0  # to plan views by: beyond this a photograph says little about the surface
OBSERVABLE_MAX_INCIDENCE_DEG = (
    80.0  # to evaluate on: beyond this a surface is foreshortened more than 5.8 times
)
SURFEL_MAX_INCIDENCE_DEG = (
    85.0  # of sparse points, whose normals are rough: only what is seen from behind is out
)
LANDMARK_MAX_INCIDENCE_DEG = (
    86.0  # of the low-fidelity simulator's landmarks; detection has limits of its own
)
