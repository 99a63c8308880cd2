"""Simulating sessions: one frame after the other, block by block, on all devices.

`simulate` is one session of a scene, `apply` runs a technique on rendered frames;
`session` is the scan over frames behind both `simulate` and studies.
"""
