"""Papers whose experiments are run again, each claim with a verdict.

`claims` has what a claim is and how an interval decides it; each paper has a file that
says what is run, what is measured, and which claims that decides (`color_space`). What
such an experiment needs and no study has stands beside it: `two_colored` (pairs of
colours, and patterns in two, seen exactly), `eye` (colour errors behind a blur).
"""
