"""The table: every public function of numbers, row by row."""

from . import curves, estimates, geometry, heads, pictures

_ROOMS = geometry, pictures, curves, heads, estimates
ROWS = [row for room in _ROOMS for row in room.ROWS]
