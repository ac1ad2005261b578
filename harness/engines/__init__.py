"""Engines, which compute cells: cells in, results out."""
