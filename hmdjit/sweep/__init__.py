"""Sweeps: a grid of studies, and the one dataset of what all of them found.

`sweep` has what users call, `dataset` puts cells together and takes them apart.
"""
