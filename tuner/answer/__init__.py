"""What a campaign found, made in one place: terminal, page, JSON, export and Python show the same record."""
