"""Study: what each departure of the public code from the paper's text does."""

from research.departures.study import DepartureFindings, DepartureSettings, analyse
from research.departures.table import DEPARTURES

__all__ = ["DEPARTURES", "DepartureFindings", "DepartureSettings", "analyse"]
