"""Studies on real photographs."""
