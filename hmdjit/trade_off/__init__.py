"""Speed against accuracy, measured on this machine.

`settings` lists the knobs, `measurement` times them on a `bench`, `choice` picks one.
"""
