"""The page of an evaluation or a reproduction: a row per strategy, Table I."""
