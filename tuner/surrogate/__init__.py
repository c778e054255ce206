"""The Gaussian process over configurations."""
