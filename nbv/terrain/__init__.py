"""What the target lies on and among: relief, neighbouring rocks, and the part of the target that is above ground."""
