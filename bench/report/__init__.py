"""The report page: one HTML file that holds a whole run, pictures and videos included."""

from bench.report.page import write_report

__all__ = ["write_report"]
