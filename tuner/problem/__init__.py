"""What is tuned: search space, objective, observations. Imports neither torch nor Optuna."""
