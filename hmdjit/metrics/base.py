"""The metric contract: `init`, `step`, `value`, streamed over what a session displays.

A metric is a frozen configuration. A session calls `step` once for each measured frame
or, where it cuts a large region into blocks, once for each block of it; colours are
gamma in `[0, 1]`, planes `(3, height, width)`. A metric that is not local gets all of
the measured block at once. Of a session's tiles a study takes the `mean`. Nothing else
knows which metrics a study has, or how many.
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, DTypeLike, Float

from .. import _checks
from .._types import Mask, Numbers, Rgb, Scalar
from ..camera import Region

State = Any
Values = Mapping[str, Float[Array | np.ndarray, "*sessions"]]
"""Values by the metrics' ids."""


class AbstractMetric(eqx.Module):
    """What is reported of a session's displayed frames."""

    id: ClassVar[str]
    """Name in tables, datasets and results."""

    unit: ClassVar[str]

    about: ClassVar[str] = ""
    """What it is, in a sentence for captions."""

    less_is_better: ClassVar[bool] = True

    needs_reference: ClassVar[bool] = False
    """Whether displayed frames are held against the reference of the same pose."""

    is_of_pairs: ClassVar[bool] = False
    """Whether it compares each frame with the one before: the first measured frame is
    then only where the first pair starts."""

    is_local: ClassVar[bool] = True
    """Whether each pixel counts on its own. What reads neighbours, as SSIM does, is not
    local: the measured block then stays in one piece, and nothing beyond it is read."""

    is_in_decibels: ClassVar[bool] = False
    """Whether it is `-10 log10` of an error's power, infinite where there is none: its
    means are those of the powers. It is no headline: decibels have no ratio."""

    is_of_tiles: ClassVar[bool] = True
    """Whether means over tiles are those over the frame; not so of a quotient."""

    @abc.abstractmethod
    def init(self, measured: Region, dtype: DTypeLike) -> State:
        """State before the first frame of the measured block."""

    @abc.abstractmethod
    def step(
        self,
        state: State,
        shown: Rgb,
        previous: Rgb | None,
        reference: Rgb | None,
        is_measured: Mask | None = None,
    ) -> State:
        """Take in a displayed frame, the one before it, and the reference.

        **Arguments:** `previous`: None for a metric that is not of pairs; `reference`:
        None where no metric needs it; `is_measured`: which pixels count, None is all.
        """

    @abc.abstractmethod
    def value(self, state: State) -> Scalar:
        """Return the metric over all frames so far."""

    def mean(self, values: Float[Array, " blocks"]) -> Array:
        """Mean over a session's blocks; infinite decibels are an error of 0."""
        if not self.is_in_decibels:
            return jnp.mean(values)
        return -10 * log10(jnp.mean(10 ** (-values / 10)))


RESERVED = frozenset(
    """technique scene session subject rotation_deg seconds sessions mean standard_error
    low high q05 q50 q95 ratio ratio_low ratio_high interval note figure_of_merit
    pairing_gain predicted predicted_extra_paths control_slope between_session_share
    simulated_sessions interim_analyses""".split()  # noqa: SIM905
)
"""Names of other variables and columns of a result."""


def check_metrics(metrics: Sequence[AbstractMetric]) -> None:
    """Raise unless there is a metric, and each has a name of its own.

    **Errors:** `ValueError` naming the ids.
    """
    ids = [metric.id for metric in metrics]
    if not ids or len(set(ids)) < len(ids):
        named = ", ".join(ids) or "none"
        raise ValueError(f"metrics must be one or more, all distinct, got {named}.")
    for id in ids:
        if not id.isidentifier() or id in RESERVED:
            raise ValueError(
                f"metrics must have ids of letters, digits and _ that no other column "
                f"of a result has, got {id!r}."
            )


def check_block(
    metrics: Sequence[AbstractMetric], width_px: int, height_px: int
) -> None:
    """Raise unless all metrics can be had of a block this large.

    **Errors:** `ValueError` of the metric's own `init`.
    """
    block = Region(0, 0, width_px, height_px)
    for metric in metrics:
        jax.eval_shape(lambda m=metric: m.init(block, jnp.float32))


class PixelMean(AbstractMetric):
    """A metric that is a mean over pixels and frames of one number per pixel."""

    @abc.abstractmethod
    def per_pixel(
        self, shown: Rgb, previous: Rgb | None, reference: Rgb | None
    ) -> Numbers:
        """Return each pixel's number, `(height, width)`."""

    def init(self, measured: Region, dtype: DTypeLike) -> State:
        """Sum and count of no pixel so far."""
        return jnp.zeros((2, 2), dtype)

    def step(
        self,
        state: State,
        shown: Rgb,
        previous: Rgb | None,
        reference: Rgb | None,
        is_measured: Mask | None = None,
    ) -> State:
        """Add the pixels of a frame, or of a block of it."""
        plane = self.per_pixel(shown, previous, reference)
        count = jnp.asarray(plane.size, plane.dtype)
        if is_measured is not None:
            plane = jnp.where(is_measured, plane, 0)
            count = jnp.sum(is_measured, dtype=plane.dtype)
        return compensated(state, jnp.stack([jnp.sum(plane), count]))

    def value(self, state: State) -> Scalar:
        """Mean over pixels and frames; NaN of no pixel."""
        (total, count), _ = state
        return total / count


def compensated(
    total: Float[Array, "2 ..."], term: Float[Array, "..."]
) -> Float[Array, "2 ..."]:
    """Add to a sum that keeps, beside it, what rounding took from it.

    A session may have 1e5 frames, and a frame many blocks.

    **Source:** Kahan, "Further remarks on reducing truncation errors", Communications
    of the ACM 8(1), 1965.
    """
    term = term - total[1]
    new = total[0] + term
    return jnp.stack([new, jax.lax.stop_gradient((new - total[0]) - term)])


def log10(power: Scalar) -> Array:
    """Logarithm; of 0 it is -inf, with a gradient of 0."""
    is_zero = power == 0
    return jnp.where(is_zero, -jnp.inf, jnp.log10(jnp.where(is_zero, 1.0, power)))


def at_least_single(values: Numbers) -> Numbers:
    """Float32 for shorter floats, which neither squares nor sums of pixels fit into."""
    return values.astype(jnp.float32) if values.dtype.itemsize < 4 else values


class Streamed:
    """A metric of a clip that comes picture by picture, `(height, width, 3)`."""

    def __init__(self, metric: AbstractMetric):
        self.metric = metric
        self._state: State = None
        self._last: Rgb | None = None
        self._count = 0

    def add(self, picture: ArrayLike, reference: ArrayLike | None = None) -> None:
        """Take in the next picture, and the one it is held against.

        **Arguments:** gamma colours, all of the first picture's size: floating in
        `[0, 1]`, or uint8 or uint16, whose largest code is 1.

        **Errors:** `ValueError` for any other dtype, range or size, and where a metric
        needs a reference and there is none.
        """
        if self.metric.needs_reference and reference is None:
            raise ValueError(f"{self.metric.id} needs a reference beside each picture.")
        shown = _planes("picture", picture, self._last)
        if self._state is None:
            _, height, width = shown.shape
            measured = Region(0, 0, width, height)
            self._state = self.metric.init(measured, shown.dtype)
        if self._last is not None or not self.metric.is_of_pairs:
            last = self._last if self.metric.is_of_pairs else None
            against = (
                None if reference is None else _planes("reference", reference, shown)
            )
            self._state = _step(self.metric, self._state, shown, last, against)
            self._count += 1
        self._last = shown

    @property
    def value(self) -> float:
        """The metric so far; NaN before there is anything to measure."""
        return float(self.metric.value(self._state)) if self._count else float("nan")


def _planes(name: str, picture: ArrayLike, like: Rgb | None) -> Rgb:
    _checks.unmasked(name, picture)
    picture = np.asarray(picture)
    size = picture.shape[:2] if like is None else like.shape[1:]
    if picture.ndim != 3 or picture.shape != (*size, 3):
        sizes = "(height, width, 3)" if like is None else f"{(*size, 3)}"
        raise ValueError(f"{name} must have the shape {sizes}, got {picture.shape}.")
    planes = _checks.colors(name, np.moveaxis(picture, -1, 0))
    return planes.astype(jnp.result_type(float))


@jax.jit
def _step(metric: AbstractMetric, *arguments: Any) -> State:
    return metric.step(*arguments)
