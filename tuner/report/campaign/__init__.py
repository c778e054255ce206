"""The page of a campaign: facts, answers, rows, provenance."""
