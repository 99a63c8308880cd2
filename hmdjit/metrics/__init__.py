"""Metrics: what is reported of a displayed clip.

`base` has the contract; MTCD, Kim et al.'s equation (6), is in `mtcd`. A session
streams the metrics of `STANDARD`, or of a study's own list, on its displayed frames;
the first of a list is its headline. `mtcd` and `Streamed` take gamma colours: uint8,
uint16 or floating in `[0, 1]`, all else is refused. `mse`, `rmsd`, `psnr` and `snr`
take two pictures on one scale, as it is; so do `ssim` and `ssim_volume`, with their
maps, and `mean_ciede2000`, whose scale has a peak: 255 if not said. `ciede2000` takes
Lab values. `by_id` finds what a study is asked for.
"""

from .base import AbstractMetric as AbstractMetric
from .base import PixelMean as PixelMean
from .base import Streamed as Streamed
from .changed_pixels import ChangedPixels as ChangedPixels
from .color_difference import CIEDE2000 as CIEDE2000
from .color_difference import ciede2000 as ciede2000
from .color_difference import ciede2000_map as ciede2000_map
from .color_difference import lab as lab
from .color_difference import mean_ciede2000 as mean_ciede2000
from .image_error import MSE as MSE
from .image_error import PSNR as PSNR
from .image_error import RMSD as RMSD
from .image_error import SNR as SNR
from .image_error import DetailLoss as DetailLoss
from .image_error import mse as mse
from .image_error import psnr as psnr
from .image_error import rmsd as rmsd
from .image_error import snr as snr
from .jod_scaling import jod as jod
from .mtcd import MTCD as MTCD
from .mtcd import mtcd as mtcd
from .observers import jod_intervals as jod_intervals
from .registry import IDS as IDS
from .registry import by_id as by_id
from .structure import SSIM as SSIM
from .structure import SSIMVolume as SSIMVolume
from .structure import ssim as ssim
from .structure import ssim_map as ssim_map
from .structure import ssim_volume as ssim_volume
from .structure import ssim_volume_map as ssim_volume_map

STANDARD: tuple[AbstractMetric, ...] = (MTCD(), DetailLoss())
"""Flicker, and what removing it costs: MTCD alone is won by a frozen picture."""
