"""Samples kept at twice the resolution, moved forward by scattering (TIDOAA)."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks, color, sample_patterns
from .._types import Rgb
from ..filters import sample_store
from ..filters.sample_store import Store
from ..frames import sources
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..technique_contract.base import SPACES, AbstractTemporal

_ORDER = (0, 3, 1, 2)  # left upper, right lower, right upper, left lower


class TIDOAA(AbstractTemporal):
    """Four samples of a rotated grid, one per frame, each moved as what it shows.

    Cells are moved to where their surfaces are now. Where cells meet the newest stays,
    then the nearest, then the first in rows from the top. What deforms is not moved.

    - `subcell`: whether a cell knows where in it its sample lies. The paper's does not,
      so that motion by less than 0.25 px per frame is not followed.
    - `space`: in which colours are mixed, `"gamma"` or `"linear"`.
    - `jitter`: without it all samples lie in the centre, and cells take turns.

    **Source:** TIDOAA, with the choices that its text leaves open.
    """

    subcell: bool = eqx.field(static=True, default=False)
    space: str = eqx.field(static=True, default="gamma")

    def __check_init__(self):
        _checks.boolean("subcell", self.subcell)
        _checks.one_of("space", self.space, SPACES)

    @property
    def id(self) -> str:
        """`tidoaa`, and what is not its default."""
        words = self.subcell * "subcell", (self.space == "linear") * "linear"
        return self._id("tidoaa", *words)

    @property
    def needs(self) -> frozenset[str]:
        """Where surfaces are, and how they move."""
        return frozenset({"color", "depth", "object_id", "motion_class", "velocity"})

    @property
    def reads_steps(self) -> bool:
        """Cells are moved forward, by how objects move."""
        return True

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Return the rotated grid, a quadrant of the pixel per frame."""
        return sample_patterns.multisample(4)[list(_ORDER)]

    @property
    def stencil_radius_px(self) -> int:
        """No neighbour is read."""
        return 0

    @property
    def history_radius_px(self) -> int:
        """What moves comes from at most a pixel farther: cells are half a pixel."""
        return 1

    def init(self, frame: Frame) -> Store:
        """Return an empty store."""
        return sample_store.empty(frame.color[0], has_offsets=self.subcell)

    def step(self, state: Store, frame: Frame, motion: Motion) -> tuple[Store, Rgb]:
        """Move the store's cells, insert the frame's, show the mean of each four."""
        sources.record_read(frame.reprojection(motion))
        store = sample_store.reprojected(state, frame, motion)
        store = self._inserted(store, frame)
        shown = sample_store.resolved(store)
        shown = color.encode(shown) if self.space == "linear" else shown
        is_known = jnp.isfinite(motion.increment).all()
        return store, jnp.where(is_known, shown, jnp.nan)

    def _inserted(self, store: Store, frame: Frame) -> Store:
        """Put each pixel in the cell where its sample lies."""
        cell = jnp.asarray(_ORDER)[store.frame % 4]
        sample_px = jnp.zeros(2, store.color.dtype)
        if self.jitter and frame.jitter_px is not None:
            sample_px = frame.jitter_px
            right, lower = (sample_px >= 0).astype(jnp.int32)
            cell = right + 2 * lower
        seen = frame.color[0]
        seen = color.decode(seen) if self.space == "linear" else seen
        return sample_store.inserted(store, frame, seen, cell, sample_px)
