"""Study: what each departure of the public code from the paper's text does."""

from tuner.studies.departures.study import DepartureFindings, DepartureSettings, analyse, fly

__all__ = ["DepartureFindings", "DepartureSettings", "analyse", "fly"]
