"""The closed loop of the paper's Fig. 1, its result and its run directory."""
