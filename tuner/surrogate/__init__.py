"""The Gaussian process over configurations: what the missions so far say about every configuration."""
