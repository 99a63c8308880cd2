"""Control variates of a study: the small-motion theory of the tiles it measures."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int

from ..camera import Camera
from ..frames.motion import Motion
from ..frames.sources import Texture
from ..simulation.sharding import over_devices, program
from ..studies.sessions import Batch
from ..techniques import HeadMovement, NoAntialiasing
from ..techniques.base import AbstractTechnique
from . import prediction as theory
from .picture_statistics import PictureStatistics, cell_numbers


def control_of(technique: AbstractTechnique) -> AbstractTechnique:
    """Return the technique whose theory moves most like what a technique shows.

    Its own without supersampling, for that needs no second table of the picture; or
    that of no anti-aliasing. How alike they are only decides how much is gained: a
    control variate never biases.
    """
    technique = technique.on_pictures()
    if isinstance(technique, HeadMovement):
        return HeadMovement(
            technique.w_min,
            technique.w_lb,
            technique.h_max_deg_s,
            technique.closeness,
            technique.weights,
            ease=technique.ease,
            localization=technique.localization,
        )
    return NoAntialiasing()


class Controls:
    """Predictions for a scene's tiles, and the techniques that they are of."""

    def __init__(
        self,
        controls: Sequence[AbstractTechnique],
        camera: Camera,
        warmup: int,
        tile_px: int,
        mesh: Mesh,
    ):
        self.controls = tuple(controls)
        self._camera, self._warmup = camera, warmup
        self._tile_px, self._mesh = tile_px, mesh

    def statistics(self, texture: Texture) -> PictureStatistics:
        """Table a scene."""
        return PictureStatistics.of(texture, self._camera, cell_px=self._tile_px)

    def predict(
        self, statistics: PictureStatistics, batch: Batch
    ) -> Float[np.ndarray, "controls sessions blocks"]:
        """MTCD of each tile by the theory of each control."""
        cells = jax.vmap(partial(cell_numbers, self._camera, self._tile_px))(
            jnp.asarray(batch.origins)
        )
        found = [
            _predict(
                statistics,
                self._camera,
                control,
                batch.motion,
                cells,
                mesh=self._mesh,
                warmup=self._warmup,
            )
            for control in self.controls
        ]
        return np.stack(found)


@program("mesh", "warmup")
def _predict(
    statistics: PictureStatistics,
    camera: Camera,
    control: AbstractTechnique,
    motion: Motion,
    cells: Int[Array, "sessions blocks"],
    *,
    mesh: Mesh,
    warmup: int,
) -> Float[Array, "sessions blocks"]:
    def one(shared: tuple, mine: tuple) -> Array:
        statistics, camera, control = shared
        path, cells = mine
        return theory.predict(
            statistics, camera, control, path, warmup=warmup, cells=cells
        )

    return over_devices(one, (statistics, camera, control), (motion, cells), mesh)
