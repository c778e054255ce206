"""A campaign: what was asked for, its ledger of missions, beginning it, running it, learning from earlier ones."""
