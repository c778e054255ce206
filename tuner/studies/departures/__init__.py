"""Study: what each departure of the public code from the paper's text does."""

from tuner.studies.departures.study import DepartureFindings, DepartureSettings, analyse
from tuner.studies.departures.table import DEPARTURES

__all__ = ["DEPARTURES", "DepartureFindings", "DepartureSettings", "analyse"]
