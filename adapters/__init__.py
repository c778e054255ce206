"""Bridges to missions that are not ours: one folder each."""

__all__: list[str] = []
