"""Measurements of the project itself, and training of the experts that are shipped."""
