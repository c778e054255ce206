"""The figures of one mission, the page to walk around in, and why a candidate won."""
