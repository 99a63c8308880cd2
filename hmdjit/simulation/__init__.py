"""Simulating sessions: one frame after the other, block by block, on all devices."""
