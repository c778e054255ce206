"""What keeps a mesh file from being a rock."""


class UnusableMesh(Exception):
    """Why a mesh file is no rock: what reads on after "mesh file NAME"."""
