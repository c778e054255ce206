"""The figures of one mission, and why a candidate won."""
