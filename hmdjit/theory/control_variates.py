"""Control variates of a study: the small-motion theory of the tiles it measures."""

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..camera import Camera
from ..frames.motion import Motion
from ..frames.texture import Texture
from ..simulation.sharding import over_sessions
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.small_motion import AsRendered, RecursiveBlend, SmallMotion
from .picture_statistics import PictureStatistics, cell_numbers
from .prediction import predict_model


def control_of(technique: AbstractTechnique) -> SmallMotion:
    """Return what moves most like what a technique shows.

    Of what it shows of each pixel's one sample: supersampling would need a second table
    of the picture. How alike they are only decides how much is gained: a control
    variate never biases. Where nothing is known, that is the picture as rendered: of
    what accumulates jittered frames it explains two thirds of the variance, or more.
    """
    model = technique.on_pictures().small_motion()
    if isinstance(model, RecursiveBlend):
        return dataclasses.replace(model, approximation="")
    return AsRendered() if model is None else model


class Controls:
    """Predictions for a scene's tiles, and the models that they are of."""

    def __init__(
        self,
        models: Sequence[SmallMotion],
        camera: Camera,
        warmup: int,
        tile_px: int,
    ):
        self.models = tuple(models)
        self._camera, self._warmup, self._tile_px = camera, warmup, tile_px

    def statistics(self, texture: Texture) -> PictureStatistics:
        """Return how much a scene differs from itself displaced, in each tile."""
        return PictureStatistics.of(texture, self._camera, cell_px=self._tile_px)

    def predict(
        self,
        statistics: PictureStatistics,
        motion: Motion,
        origins: Int[Array | np.ndarray, "sessions blocks 2"],
    ) -> Float[np.ndarray, "controls sessions blocks"]:
        """MTCD of each session's tiles by the theory of each model."""
        cells = jax.vmap(partial(cell_numbers, self._camera, self._tile_px))(
            jnp.asarray(origins)
        )
        found = [
            over_sessions(
                _predict,
                (statistics, self._camera, model),
                (motion, cells),
                warmup=self._warmup,
            )
            for model in self.models
        ]
        return np.stack(found) if found else np.zeros((0, *origins.shape[:2]))


def _predict(shared: tuple, mine: tuple, *, warmup: int) -> Float[Array, " blocks"]:
    statistics, camera, model = shared
    motion, cells = mine
    return predict_model(statistics, camera, model, motion, cells, warmup=warmup)
