"""``wyner report``: a run on one page of HTML that needs no network, no script, no library."""

from wyner.runs.page.page import write_report

__all__ = ["write_report"]
