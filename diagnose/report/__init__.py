"""The page ``report.html``: one file, for a person, that answers where, what, how sure, what not, and what to measure next."""

from diagnose.report.page import write_report

__all__ = ["write_report"]
