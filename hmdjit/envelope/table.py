"""The table: every public function of numbers, row by row."""

from . import estimates, geometry, heads, pictures, searches

ROWS = [
    *geometry.QUATERNIONS,
    *geometry.CAMERAS,
    *geometry.PASTS,
    *pictures.COLOURS,
    *pictures.READERS,
    *pictures.CURVES,
    *heads.HEADS,
    *searches.SEARCHES,
    *pictures.METRICS,
    *estimates.ESTIMATES,
]
