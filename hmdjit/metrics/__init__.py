"""Metrics: what is reported of a displayed clip.

`base` has the contract; MTCD, Kim et al.'s equation (6), is in `mtcd`. A session
streams the metrics of `STANDARD`, or of a study's own list, on its displayed frames;
the first of a list is its headline. `mtcd` and `Streamed` take gamma colours: uint8,
uint16 or floating in `[0, 1]`, all else is refused. `mse`, `rmsd`, `psnr` and `snr`
take two pictures on one scale, as it is.
"""

from .base import AbstractMetric as AbstractMetric
from .base import PixelMean as PixelMean
from .base import Streamed as Streamed
from .color_difference import ciede2000 as ciede2000
from .color_difference import lab as lab
from .image_error import DetailLoss as DetailLoss
from .image_error import mse as mse
from .image_error import psnr as psnr
from .image_error import rmsd as rmsd
from .image_error import snr as snr
from .mtcd import MTCD as MTCD
from .mtcd import mtcd as mtcd

STANDARD: tuple[AbstractMetric, ...] = (MTCD(), DetailLoss())
"""Flicker, and what removing it costs: MTCD alone is won by a frozen picture."""
