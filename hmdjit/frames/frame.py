"""What rendering hands to a technique."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, DTypeLike, Float, Int, Shaped

from .._types import Plane, Rgb, RotationVector, Samples
from ..camera import Camera, Region
from .displacement import (
    GATHER,
    AnyDisplacement,
    Displacement,
    DisplacementField,
    Reading,
)
from .motion import Motion

CHANNELS: Mapping[str, tuple[int, DTypeLike | None]] = {
    "color": (3, None),
    "albedo": (3, None),
    "depth": (1, None),
    "velocity": (2, None),
    "object_id": (1, jnp.int32),
    "motion_class": (1, jnp.int32),
    "coverage": (1, jnp.int32),
}
"""Planes of each channel, and their dtype; None is the colours'."""

MOTION_CLASSES = ("static", "rigid", "deforming")
"""What the numbers of the channel `motion_class` mean."""


Steps = tuple[Float[Array, "objects 3"], Float[Array, "objects 3"]]


class Frame(eqx.Module):
    """What rendering hands to a technique: colour and only the channels asked for.

    - `color`: gamma, one picture per sub-pixel sample, `(samples, 3, height, width)`.
    - `camera`, `region`: which pixels these are.
    - `static_mask`: True where the scene is static, `(height, width)`; None is
      everywhere.
    - `reading`: how techniques read their history.
    - `channels`: what else the technique needs, by name, one plane or stack of planes
      per sample, `(samples, channels, height, width)`. See the properties.
    - `velocity_bounds`: smallest and largest displacement of `reprojection`, px, where
      it is a field; None are the field's own.
    - `steps`: increment and translation of the head against each object since the last
      frame, `(objects, 3)` each, row i of the object with the id i; for techniques that
      need `velocity` and `reads_steps`. None where nothing moves by itself.
    - `jitter_px`: where the one sample of each pixel lies in this frame, from its
      centre, px, x right and y down; None is the centre, or several samples.
    """

    color: Samples
    camera: Camera
    region: Region
    static_mask: Bool[Array, "height width"] | None = None
    reading: Reading = GATHER
    channels: Mapping[str, Shaped[Array, "samples channels height width"]] = eqx.field(
        default_factory=dict
    )
    velocity_bounds: Float[Array, "2 2"] | None = None
    jitter_px: Float[Array, "2"] | None = None
    steps: Steps | None = None

    @property
    def depth(self) -> Plane:
        """Distance from the eye along -z, m, of the first sample; inf of background."""
        return self.channels["depth"][0, 0]

    @property
    def object_id(self) -> Int[Array, "height width"]:
        """Which object the first sample sees; 0 is the background."""
        return self.channels["object_id"][0, 0]

    @property
    def motion_class(self) -> Int[Array, "height width"]:
        """Whether that is static (0), rigid (1) or deforming (2)."""
        return self.channels["motion_class"][0, 0]

    @property
    def albedo(self) -> Rgb:
        """Gamma colour of the first sample's surface before it is lit."""
        return self.channels["albedo"][0]

    @property
    def content_px(self) -> Float[Array, "2"] | None:
        """Where the content of pixels' centres lies, from these, px; None is there."""
        return None if self.jitter_px is None else -self.jitter_px

    def displacement(self, rotation: RotationVector) -> Displacement:
        """Where the sources of this frame's pixels lie when their rays are turned."""
        return Displacement(self.camera, self.region, rotation, None, self.reading)

    def reprojection(self, motion: Motion) -> AnyDisplacement:
        """Where the content of each pixel was in the last frame.

        For techniques that need `velocity`. A formula where only the head turns; else
        against the channel `velocity`, which says how the content of the first sample
        moved since the last frame: px, x to the right and y down.
        """
        if "velocity" not in self.channels:
            return self.displacement(motion.increment)
        dx, dy = -self.channels["velocity"][0]
        return DisplacementField(
            self.camera, self.region, dx, dy, self.velocity_bounds, self.reading
        )
