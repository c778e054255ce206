"""Files of other programs: the authors' configuration and mission, QGroundControl's ``.plan``."""
