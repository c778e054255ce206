"""Study: what each departure of the public code from the paper's text does."""
