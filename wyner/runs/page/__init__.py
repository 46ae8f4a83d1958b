"""``wyner report``: a run on one page of HTML that needs no network, no script, no library."""

from wyner.runs.page.page import StepError, write_report

__all__ = ["StepError", "write_report"]
