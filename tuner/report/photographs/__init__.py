"""Pages about sets of real photographs."""

from tuner.report.photographs.import_page import write_import_report

__all__ = ["write_import_report"]
