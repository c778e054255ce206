"""Pages and pictures about sets of real photographs."""

from tuner.report.photographs.enough_picture import draw_enough
from tuner.report.photographs.import_page import write_import_report

__all__ = ["draw_enough", "write_import_report"]
