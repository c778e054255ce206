"""Study: what an oracle that sees the true surface gains, by its notion of coverage."""
