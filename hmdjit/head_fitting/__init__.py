"""Fitting head motion to recordings."""
