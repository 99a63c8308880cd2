"""The table: every public function of numbers, row by row."""

from . import rows_estimates, rows_geometry, rows_heads, rows_pictures

ROWS = [
    *rows_geometry.QUATERNIONS,
    *rows_geometry.CAMERAS,
    *rows_geometry.PASTS,
    *rows_pictures.COLOURS,
    *rows_pictures.READERS,
    *rows_pictures.CURVES,
    *rows_heads.HEADS,
    *rows_heads.SEARCHES,
    *rows_pictures.METRICS,
    *rows_estimates.ESTIMATES,
]
