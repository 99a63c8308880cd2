"""The table: every public function of numbers, row by row."""

from . import curves, estimates, geometry, heads, pictures

ROWS = [
    *geometry.GEOMETRY,
    *pictures.PICTURES,
    *curves.CURVES,
    *heads.HEADS,
    *estimates.ESTIMATES,
]
