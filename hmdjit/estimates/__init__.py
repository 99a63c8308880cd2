"""Estimates with their errors and intervals; NumPy only."""
