"""Drive a racing car."""
