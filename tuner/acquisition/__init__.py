"""What to run next: the acquisition function and its maximum."""
