"""How one mission is flown for the tuner: jobs, outcomes, executors."""
