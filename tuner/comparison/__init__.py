"""Strategies against each other: plan, missions, table with paired statistics, verdict, and what to fly."""
