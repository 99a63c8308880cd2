"""Temporal anti-aliasing only where edges alias, after Oliveros' thesis."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import _checks, sample_patterns
from .._types import Rgb
from ..filters import aliasing, neighborhood, same_surface, temporal
from ..filters.aliasing import Intermediates
from ..frames.frame import Frame
from ..frames.motion import Motion
from ..frames.sources import History
from ..technique_contract.base import OFF_SCREEN, AbstractTemporal
from ..technique_contract.display_stages import Sharpening

DEPTH_HISTORIES = ("same_pixel", "reprojected")


class Kept(NamedTuple):
    """What is kept of the past.

    - `shown`: colour before it is sharpened, and the temporal Sobel.
    - `depth`: of `temporal.thesis_depth`.
    """

    shown: History
    depth: History


class SobelTAA(AbstractTemporal):
    """The past counts the more, the more a pixel may be aliased; sharpened.

    That is told by edges of colour, albedo and depth, by how many models are around,
    and by depth. Where nothing is, the present is shown.

    - `depth_range`: what depths are held against, `"paper"`: from the mean to the
      nearer of a block's ends; `"code"`: to the smallest.
    - `depth_history`: past depth of the `"same_pixel"` (the code), or `"reprojected"`.
    - `off_screen`: past that is off screen is the screen's edge, `"clamp"`, or
      `"reject"`, the present.
    - `jitter`: whether the camera moves its samples, 16 points over 1.7 px.

    **Source:** Oliveros, thesis, "Master TAA".
    """

    depth_range: str = eqx.field(static=True, default="paper")
    depth_history: str = eqx.field(static=True, default="same_pixel")
    off_screen: str = eqx.field(static=True, default="clamp")

    def __check_init__(self):
        _checks.one_of("depth_range", self.depth_range, aliasing.DEPTH_RANGES)
        _checks.one_of("depth_history", self.depth_history, DEPTH_HISTORIES)
        _checks.one_of("off_screen", self.off_screen, OFF_SCREEN)

    @property
    def id(self) -> str:
        """`sobel_taa`, `sobel_taa_code_reprojected_reject`."""
        chosen = self.depth_range, self.depth_history, self.off_screen
        usual = "paper", "same_pixel", "clamp"
        words = [w for w, default in zip(chosen, usual, strict=True) if w != default]
        return self._id("sobel_taa", *words)

    @property
    def needs(self) -> frozenset[str]:
        """Edges of all kinds, models, and how pixels move."""
        return frozenset({"color", "albedo", "depth", "object_id", "velocity"})

    @property
    def jitter_pattern_px(self) -> Float[np.ndarray, "period 2"]:
        """Scrambled Halton points: as the accumulation buffer's, farther apart."""
        return sample_patterns.thesis_jitter()

    @property
    def stencil_radius_px(self) -> int:
        """Edges, un-jittered, around a pixel and around its neighbours; sharpened."""
        return 6

    @property
    def history_radius_px(self) -> int:
        """The mean of the temporal Sobel."""
        return 1

    @property
    def display_slope(self) -> float:
        """That of sharpening."""
        return Sharpening().slope

    def init(self, frame: Frame) -> Kept:
        """Keep the un-jittered frame, its edges and its depth."""
        depth = temporal.thesis_depth(frame.depth)
        edges = aliasing.edge_strength(frame.color[0], frame.albedo, depth)
        shown = jnp.concatenate([frame.color[0], edges[None]])
        return Kept(
            History.of(temporal.unjittered(shown, frame.jitter_px)),
            History.of(neighborhood.shifted_nearest(depth[None], frame.content_px)),
        )

    def step(self, state: Kept, frame: Frame, motion: Motion) -> tuple[Kept, Rgb]:
        """Blend in the past, clipped to a box that is as large as aliasing may be."""
        seen = self.intermediates(state, frame, motion)
        around = temporal.unjittered(frame.color[0], frame.jitter_px, margin_px=1)

        def clipped() -> Rgb:
            boxes = neighborhood.plus_and_block(around, margin_px=1)
            box = aliasing.narrowed(*boxes, seen.current, seen.aliased)
            return temporal.clip_to_center(seen.past, box)

        past = neighborhood.apart(clipped, seen.current)
        shown = temporal.thesis_blend(seen.current, past)
        kept = jnp.concatenate([shown, seen.temporal_sobel[None]])
        state = Kept(History.of(kept), History.of(seen.depth[None]))
        return state, Sharpening().show(shown, frame, motion)

    def intermediates(self, state: Kept, frame: Frame, motion: Motion) -> Intermediates:
        """Return what the picture of a frame is made of."""
        at = temporal.unjittered_reprojection(frame, motion)
        clamps = self.off_screen == "clamp"
        depth = temporal.thesis_depth(frame.depth)
        sobel = aliasing.edge_strength(frame.color[0], frame.albedo, depth)

        edges = temporal.unjittered(sobel[None], frame.jitter_px, margin_px=1)
        current = temporal.unjittered(frame.color[0], frame.jitter_px)
        now = jnp.concatenate([current, edges[:, 1:-1, 1:-1]])
        past = temporal.past(state.shown, at, now, clamps=clamps)
        temporal_sobel = neighborhood.apart(
            lambda: aliasing.temporal_edges(edges, past[3]), current
        )

        beside = {"by_px": frame.content_px, "margin_px": 1}
        ids = neighborhood.shifted_nearest(frame.object_id, **beside)
        models = aliasing.differing_share(ids, depth.dtype)
        depths = neighborhood.shifted_nearest(depth, **beside)
        depth = depths[1:-1, 1:-1]
        if self.depth_history == "reprojected":
            (past_depth,) = same_surface.nearest(state.depth, at)
            is_known = jnp.isfinite(past_depth) & (at.inside() | clamps)
            past_depth = jnp.where(is_known, past_depth, depth)
        else:
            (past_depth,) = state.depth.under(frame.region)
        terms = models, *aliasing.depth_terms(depths, past_depth, self.depth_range)
        *terms, aliased = neighborhood.apart(
            lambda: (*terms, aliasing.aliased_value(temporal_sobel, *terms)), current
        )
        seen = (sobel, temporal_sobel, *terms, aliased, current, past[:3], depth)
        return Intermediates._make(seen)
