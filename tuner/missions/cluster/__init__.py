"""Missions on other machines, by Dask (extra ``cluster``); nothing else here needs it.

The coordinator, which has the model and the ledger, is a client of a Dask scheduler. A worker runs every mission in a process
of its own (`tuner.missions.executors.LocalProcessExecutor`) with its own store, and sends the mission's directory back.
"""
