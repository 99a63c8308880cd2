"""Fitting the head model to recordings: `fitting.fit_heads`, with standard errors.

`statistics` says what recorded heads do, and whether a model's do the same.
"""
