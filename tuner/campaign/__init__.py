"""A campaign: what was asked for, its ledger of missions, beginning it, flying it, learning from earlier ones."""
