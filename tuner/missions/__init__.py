"""How missions are flown for the tuner: fidelities by name, jobs and their trials, processes to fly them in."""
