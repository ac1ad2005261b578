"""Keep a pole upright, on a cart."""
