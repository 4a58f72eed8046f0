"""The page a person looks at: one HTML file that asks nobody for anything."""

from rpl_data.report.tables import PAPER_MEANS
from rpl_data.report.write import write_report

__all__ = ["PAPER_MEANS", "write_report"]
