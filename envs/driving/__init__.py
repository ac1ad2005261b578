"""Drive on a highway."""
