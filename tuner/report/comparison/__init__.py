"""The page of an evaluation or a reproduction: Table I, paired differences, figures."""
