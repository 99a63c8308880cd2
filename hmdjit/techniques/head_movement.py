"""Head-movement based temporal anti-aliasing (Kim et al.)."""

import dataclasses
import functools
import math
import operator
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .. import _checks, blending, color, quaternion, reprojection
from .._types import Mask, Rgb, Scalar
from ..curves import AbstractCurve, Kim, Linear
from ..filters import dynamic_regions
from ..frames.displacement import AnyDisplacement
from ..frames.frame import MOTION_CLASSES, Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import SPACES, AbstractSpatial, AbstractTechnique
from ..technique_contract.small_motion import RecursiveBlend

DIFFERENCES = ("euclidean", "max_channel", "same_pixel")
REPROJECTIONS = ("rotation", "rigid")
DYNAMIC = ("none", "classes", "frames")


def _optional_numbers(values) -> tuple | None:
    return None if values is None else _checks.numbers(values)


class HeadMovement(AbstractTechnique):
    """Blend each frame with the displayed past, found from the head's movement alone.

    - `w_min`: weight of the current picture at rest; in `[0, 1]`.
    - `w_lb`: that weight where past and present differ most; in `[0, w_min]`.
    - `h_max_deg_s`: head speed from which only the current picture is shown; above 0.
    - `closeness`: Kim's d of each past sample, in `[0, 1]`: 1 is the current pose.
    - `weights`: of the past samples; None is `d_i / sum d`. Scaled to sum to 1.
    - `resolve`: how a frame's samples become one picture: none, SSAA or MSAA.
    - `difference`: what localises the weight: `"euclidean"` and `"max_channel"` compare
      with the reprojected past, `"same_pixel"` with the last displayed pixel.
    - `space`: colour space of everything above, `"gamma"` or `"linear"`.
    - `ease`: the curve by which head speed, over `h_max_deg_s`, counts.
    - `localization`: the curve by which the difference of past and present counts.
    - `label`: part of the id, to tell several in one study apart; decides nothing.
    - `reprojects`: how the past is found: by the head's `"rotation"` alone, or by the
      `"rigid"` transform between its poses, with depth.
    - `dynamic`: where the current picture is shown because things move by themselves,
      beside where `Frame.static_mask` is False: `"none"`; `"classes"`, where the
      channel `motion_class` is not static; `"frames"`, where the frames say so.

    **Source:** Kim et al., equations (1) to (5), with the paper's constants and curves
    as defaults; sections 4.1 (rigid) and 4.4 (classes). That frames say so is ours.
    """

    w_min: Scalar = eqx.field(converter=_checks.number, default=0.3)
    w_lb: Scalar = eqx.field(converter=_checks.number, default=0.1)
    h_max_deg_s: Scalar = eqx.field(converter=_checks.number, default=25.0)
    closeness: tuple[Scalar, ...] = eqx.field(
        converter=_checks.numbers, default=(2 / 3,)
    )
    weights: tuple[Scalar, ...] | None = eqx.field(
        converter=_optional_numbers, default=None
    )
    resolve: AbstractSpatial | None = None
    difference: str = eqx.field(static=True, default="euclidean")
    space: str = eqx.field(static=True, default="gamma")
    ease: AbstractCurve = eqx.field(default_factory=Kim)
    localization: AbstractCurve = eqx.field(default_factory=Linear)
    label: str = eqx.field(static=True, default="")
    reprojects: str = eqx.field(static=True, default="rotation")
    dynamic: str = eqx.field(static=True, default="none")

    def __check_init__(self):
        _checks.in_range("w_min", self.w_min, 0, 1)
        _checks.in_range("w_lb", self.w_lb, 0, 1)
        known = not (_checks.is_traced(self.w_min) or _checks.is_traced(self.w_lb))
        if known and self.w_lb > self.w_min:
            raise ValueError(
                f"w_lb must lie in [0, w_min = {self.w_min:g}], got "
                f"{_checks.apart(self.w_lb, self.w_min)}."
            )
        _checks.in_range("h_max_deg_s", self.h_max_deg_s, 0, open_low=True)
        if not self.closeness:
            raise ValueError("closeness must name at least one past sample, got ().")
        for i, d in enumerate(self.closeness):
            _checks.in_range(f"closeness[{i}]", d, 0, 1)
        if self.weights is not None and len(self.weights) != len(self.closeness):
            raise ValueError(
                f"weights must have one entry per past sample ({len(self.closeness)}), "
                f"got {len(self.weights)}."
            )
        for i, weight in enumerate(self._raw_weights()):
            _checks.in_range(f"weights[{i}]", weight, 0)
        total = 1.0 if self.weights is None else sum(self.weights)
        if not _checks.is_traced(total) and total <= 0:
            raise ValueError(f"weights must have a positive sum, got {total:g}.")
        if not isinstance(self.resolve, AbstractSpatial | None):
            raise ValueError(
                f"resolve must be an AbstractSpatial or None, got {self.resolve!r}."
            )
        _checks.one_of("difference", self.difference, DIFFERENCES)
        _checks.one_of("space", self.space, SPACES)
        _checks.one_of("reprojects", self.reprojects, REPROJECTIONS)
        _checks.one_of("dynamic", self.dynamic, DYNAMIC)

    @property
    def id(self) -> str:
        """`head_movement_rigid_frames:label+ssaa2`, with all that is no default."""
        usual = ("rotation", "none")
        words = [w for w in (self.reprojects, self.dynamic) if w not in usual]
        label = f":{self.label}" if self.label else ""
        resolve = f"+{self.resolve.id}" if self.resolve else ""
        return "_".join(["head_movement", *words]) + label + resolve

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Samples of `resolve`, or one in the centre."""
        return (self.resolve or super()).sample_offsets_px

    @property
    def reads_static_mask(self) -> bool:
        """Where the scene is not static, the frame is shown."""
        return True

    @property
    def reads_supersampled(self) -> bool:
        """Whether `resolve` does."""
        return self.resolve is not None and self.resolve.reads_supersampled

    @property
    def shades_once_per_pixel(self) -> bool:
        """As the spatial technique before it."""
        return self.resolve is not None and self.resolve.shades_once_per_pixel

    def _raw_weights(self) -> tuple[Scalar, ...]:
        return self.closeness if self.weights is None else self.weights

    def _normalized_weights(self) -> list[Scalar]:
        """Weights of equation (2): they sum to 1."""
        raw, count = self._raw_weights(), len(self.closeness)
        if count == 1:
            return [1.0]
        # Samples that are all at d = 0 have no ratio of d: they count alike.
        total = sum(raw)
        is_zero = total == 0
        safe = jnp.where(is_zero, 1.0, total)
        return [jnp.where(is_zero, 1 / count, weight / safe) for weight in raw]

    @property
    def needs(self) -> frozenset[str]:
        """Channels that `resolve` needs, or colour; depth, and classes."""
        own = super().needs if self.resolve is None else self.resolve.needs
        depth = {"depth"} if self.reprojects == "rigid" else set()
        return own | depth | ({"motion_class"} if self.dynamic == "classes" else set())

    @property
    def stencil_radius_px(self) -> int | None:
        """Radius of `resolve`, and of what the frames say."""
        own = 0 if self.resolve is None else self.resolve.stencil_radius_px
        if own is None or self.dynamic != "frames":
            return own
        return own + dynamic_regions.REACH_PX

    @property
    def history_radius_px(self) -> int:
        """The past is read where it was shown; what frames say has a reach."""
        return dynamic_regions.PAST_REACH_PX if self.dynamic == "frames" else 0

    def _current(self, frame: Frame) -> Rgb:
        gamma = self.resolve.resolve(frame) if self.resolve else frame.color[0]
        return color.decode(gamma) if self.space == "linear" else gamma

    def init(self, frame: Frame) -> History:
        """History starts as the first frame."""
        return History.of(self._current(frame))

    def step(self, state: History, frame: Frame, motion: Motion) -> tuple[History, Rgb]:
        """Blend the reprojected past in, by Kim et al., equations (1) to (5)."""
        current = self._current(frame)
        speed_rad = quaternion.angle(motion.increment) * frame.camera.refresh_hz
        easing = blending.ease(speed_rad * (180 / np.pi), self.h_max_deg_s, self.ease)

        moved_m = motion.translation_m if self.reprojects == "rigid" else None
        past = [
            reprojection.past_position(frame, motion.increment, d, moved_m)
            for d in self.closeness
        ]
        weights = self._normalized_weights()
        is_blended = self.has_past(frame, past)
        # Masked before they are weighted, so that gradients of the weights are, too.
        samples = [blending.usable(state.at(p), current, is_blended) for p in past]
        history = blending.past_color(samples, weights)
        if self.dynamic == "frames":
            is_moving = dynamic_regions.unexplained(current, history)
            is_blended = is_blended & ~is_moving
            history = blending.usable(history, current, is_blended)

        if self.difference == "same_pixel":
            same_pixel = blending.usable(state.under(frame.region), current, is_blended)
            difference = blending.color_difference(current, same_pixel)
        else:
            difference = blending.color_difference(
                current, history, kind=self.difference
            )
        minimum = blending.localized_minimum(
            self.w_min, self.w_lb, difference, self.localization
        )
        weight = blending.current_weight(minimum, easing)
        displayed = blending.blend(current, history, weight)

        shown = color.encode(displayed) if self.space == "linear" else displayed
        return History.of(displayed), shown

    @property
    def is_valid(self) -> Bool[Array, ""] | bool:
        """Whether its numbers are in the ranges above."""
        found = (self.w_lb >= 0) & (self.w_lb <= self.w_min) & (self.w_min <= 1)
        found = found & (self.h_max_deg_s > 0) & (self.h_max_deg_s < math.inf)
        found = found & self.ease.is_valid & self.localization.is_valid
        for d in self.closeness:
            found = found & (d >= 0) & (d <= 1)
        for weight in self._raw_weights():
            found = found & (weight >= 0) & (weight < math.inf)
        if self.weights is not None:
            found = found & (sum(self.weights) > 0)
        return found if self.resolve is None else found & self.resolve.is_valid

    def has_past(self, frame: Frame, past: Sequence[AnyDisplacement]) -> Mask:
        """Where all past samples are usable: static, and inside the frame before."""
        found = functools.reduce(operator.and_, (p.inside() for p in past))
        if self.dynamic == "classes":
            found = found & (frame.motion_class == MOTION_CLASSES.index("static"))
        return found if frame.static_mask is None else found & frame.static_mask

    def on_pictures(self) -> "HeadMovement":
        """On pictures nothing is near or moves, and MSAA resolves one sample."""
        if self.needs == {"color"} and self.resolve is None:
            return self
        spatial = None if self.resolve is None else self.resolve.on_pictures()
        spatial = None if spatial is None or spatial.id == "none" else spatial
        dynamic = "frames" if self.dynamic == "frames" else "none"
        alike = {"resolve": spatial, "reprojects": "rotation", "dynamic": dynamic}
        return dataclasses.replace(self, **alike)

    def history_gain(
        self, speed_deg_s: Float[np.ndarray, "*sessions frames"]
    ) -> Float[np.ndarray, "*sessions frames"]:
        """How much of an error in the history remains.

        An error e in the history changes `(1 - A) H` by `(1 - A) e`, at most
        `(1 - w_lb) (1 - E) e`; and A itself through equation (5) by at most
        `s (w_min - w_lb) (1 - E) e`, with s the localisation's steepest slope, which
        counts by how far H is from the present, at most 1. In all that is
        `(1 - w_min + (1 + s) (w_min - w_lb)) (1 - E)`.
        """
        easing = np.asarray(
            blending.ease(jnp.asarray(speed_deg_s), self.h_max_deg_s, self.ease)
        )
        if self.dynamic == "frames":  # however small, it may decide what is blended
            return np.where(easing < 1, 1e5, 0.0)
        w_min, w_lb = float(self.w_min), float(self.w_lb)
        steepest = self.localization.steepest
        return (1 - w_min + (1 + steepest) * (w_min - w_lb)) * (1 - easing)

    @property
    def display_slope(self) -> float:
        """In linear light what is displayed is what is kept, encoded."""
        return color.STEEPEST_ENCODE if self.space == "linear" else 1.0

    def small_motion(self) -> RecursiveBlend:
        """How the blend lags behind the scene, all past samples at their mean."""
        is_tabled = self.difference != "max_channel" and self.space == "gamma"
        why = "" if is_tabled else "only RGB distances of gamma colours are tabled"
        if self.resolve is not None and self.resolve.stencil_radius_px != 0:
            why = f"{self.resolve.id} changes the picture before it is blended"
        if self.dynamic == "frames":
            why = "what frames take for dynamic is not blended"
        closeness = self._mean_closeness()
        return RecursiveBlend(
            closeness,
            1.0 if self.difference == "same_pixel" else closeness,
            self.w_min,
            self.w_lb,
            self.h_max_deg_s,
            self.ease,
            self.localization,
            why,
        )

    def _mean_closeness(self) -> Scalar:
        """Mean closeness of the past samples, by their weights in equation (2)."""
        raw, total = self._raw_weights(), sum(self._raw_weights())
        is_zero = total == 0  # all samples are at d = 0
        mean = sum(w * c for w, c in zip(raw, self.closeness, strict=True))
        mean = mean / jnp.where(is_zero, 1, total)
        return jnp.where(is_zero, 0.0, mean)
