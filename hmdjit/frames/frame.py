"""What rendering hands to a technique."""

from collections.abc import Mapping

import equinox as eqx
from jaxtyping import Array, Bool, Shaped

from .._types import RotationVector, Samples
from ..camera import Camera, Region
from .displacement import GATHER, Displacement, Reading


class Frame(eqx.Module):
    """What rendering hands to a technique: colour and only the channels asked for.

    - `color`: gamma, one picture per sub-pixel sample, `(samples, 3, height, width)`.
    - `camera`, `region`: which pixels these are.
    - `static_mask`: True where the scene is static, `(height, width)`; None is
      everywhere.
    - `reading`: how techniques read their history.
    - `channels`: what else the technique needs, by name, one plane or stack of planes
      per sample, `(samples, channels, height, width)`.
    """

    color: Samples
    camera: Camera
    region: Region
    static_mask: Bool[Array, "height width"] | None = None
    reading: Reading = GATHER
    channels: Mapping[str, Shaped[Array, "samples channels height width"]] = eqx.field(
        default_factory=dict
    )

    def displacement(self, rotation: RotationVector) -> Displacement:
        """Where the sources of this frame's pixels lie when their rays are turned."""
        return Displacement(self.camera, self.region, rotation, None, self.reading)
