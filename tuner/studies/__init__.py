"""What a user asks before and after tuning: how noisy missions are, which parameters matter."""
