"""Estimates with their errors and intervals; NumPy only.

`estimate` has means, ratios and control variates, `intervals` what is said of them,
`planning` how many sessions an error takes, `summary` the rows of a study's table.
"""
