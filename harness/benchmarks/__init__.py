"""What measures the project itself, and trains the experts that are shipped."""
