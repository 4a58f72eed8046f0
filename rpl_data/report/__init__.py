"""The report of a build: one HTML file that loads nothing from elsewhere."""

from rpl_data.report.tables import PAPER_MEANS
from rpl_data.report.write import write_report

__all__ = ["PAPER_MEANS", "write_report"]
