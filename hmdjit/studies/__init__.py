"""Studies: scenes x techniques x sessions, all on the same head paths.

`study` has what users call, `definition` its fields. `run` runs a fixed number of
sessions, or, scene by scene, until `sequential` finds a tolerance or a budget reached
(`Until`, by the interim analyses of `estimates.planning`). `sessions` draws head paths
and blocks, `runner` measures a batch of them, `store` keeps batches for a resume.
"""
