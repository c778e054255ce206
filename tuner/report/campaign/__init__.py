"""The page of a campaign: facts, figures, rows, provenance."""
