"""Missions on other machines, by Dask (extra ``cluster``): the coordinator, which has model and ledger, is a scheduler's client."""
