"""Swing something up, and hold it there."""
