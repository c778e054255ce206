"""Studies that come before and after tuning: how noisy the objective is, what it depends on, where its result holds."""
