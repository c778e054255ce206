"""Studies that come before and after tuning: how noisy the objective is, and what it depends on."""
