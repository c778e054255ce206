"""Which configuration to use, and which may be recommended at all."""
