"""How missions are run for the tuner: fidelities by name, jobs and their trials, processes to run them in."""
