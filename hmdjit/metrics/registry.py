"""Metrics by their ids."""

from .. import _checks
from .base import AbstractMetric
from .changed_pixels import ChangedPixels
from .color_difference import CIEDE2000
from .image_error import MSE, PSNR, RMSD, SNR, DetailLoss
from .mtcd import MTCD
from .structure import SSIM, SSIMVolume

_METRICS: dict[str, AbstractMetric] = {
    metric.id: metric
    for metric in (
        MTCD(),
        DetailLoss(),
        MSE(),
        RMSD(),
        PSNR(),
        SNR(),
        SSIM(),
        SSIMVolume(),
        CIEDE2000(),
        *map(ChangedPixels, (1, 2, 5)),
    )
}

IDS = tuple(_METRICS)


def by_id(id: str) -> AbstractMetric:
    """Metric of an id such as `mtcd`, `detail_loss`, `ssim`.

    **Errors:** `ValueError` naming the known ids, with the nearest as a suggestion.
    """
    _checks.one_of("metrics", id, IDS)
    return _METRICS[id]
