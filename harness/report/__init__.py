"""The report of a run: one value, and what renders it."""
