"""What to fly next: the acquisition function and its maximum."""
