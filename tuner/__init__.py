"""Many missions: tune the hybrid gate with Bayesian optimisation, compare, report."""
