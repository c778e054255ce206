"""One complete next-best-view mission: fly, photograph, reconstruct, plan, measure."""
