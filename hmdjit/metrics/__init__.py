"""Metrics: what is reported of a displayed clip."""

from .image_error import mse as mse
from .image_error import psnr as psnr
from .image_error import rmsd as rmsd
from .image_error import snr as snr
from .mtcd import StreamedMtcd as StreamedMtcd
from .mtcd import mtcd as mtcd
