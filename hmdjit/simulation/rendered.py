"""Frames rendered elsewhere, with what techniques need of them beside their colour."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float, Shaped
from scipy.spatial.transform import Rotation

from .. import _checks
from ..camera import Camera, Region
from ..frames.displacement import GATHER, Reading
from ..frames.frame import CHANNELS, MOTION_CLASSES, Frame
from ..frames.motion import Motion, check_poses, checked_motion
from ..frames.velocity import against_object, past_displacement
from ..technique_contract.base import AbstractTechnique

KEYWORDS = {
    "depth": ("depth", "--depth"),
    "object_id": ("object_id", "--id"),
    "motion_class": ("motion_class", "--class"),
    "albedo": ("albedo", "--albedo"),
    "velocity": ("velocity_px", "--velocity"),
}
"""By which keyword of `apply`, and which option, a channel is given."""

_MOST = {"object_id": 2**24 - 1, "motion_class": len(MOTION_CLASSES) - 1}
_MOST_JITTER_PX = 1.5
_RIGID = MOTION_CLASSES.index("rigid")

Given = Mapping[str, Any]
Against = tuple[Float[Array, "..."], Float[Array, "..."]]


class Views(eqx.Module):
    """From where a frame was rendered, or those of a clip: row by row, over and over.

    - `motion`: of the head; NaN where it is unknown.
    - `against`: what velocity is made of, if that is derived from depth: increment and
      translation of the head, `(3,)`, or against each object, `(objects, 3)`.
    - `steps`: increment and translation of the head against each object, for techniques
      that read them.
    - `samples_px`: where samples lie, from the pixel centre; None where nobody asks.
    - `jitters`: whether the one sample of a pixel is said to lie elsewhere.
    """

    motion: Motion
    against: Against | None
    steps: Against | None
    samples_px: Float[Array, "*rows samples 2"] | None
    jitters: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        technique: AbstractTechnique,
        given: Given,
        dtype: DTypeLike,
        poses: Any,
        object_poses: Any,
        jitter_px: Any,
    ) -> "Views":
        """Check poses and jitter; find out what velocity is made of.

        **Arguments:** `given`: channels, by name; `poses`: None where none are known.

        **Errors:** `ValueError` for what is wrong, or lacks for the velocity.
        """
        unknown = jnp.full((1, 3), jnp.nan, dtype)  # shows wherever it is used
        motion, objects, against = Motion(unknown, unknown), None, None
        if poses is not None:
            check_poses(poses)
            motion = checked_motion(poses, dtype)
        if object_poses is not None:
            objects = _against(motion, poses, object_poses)
        if "velocity" in technique.needs - set(given):
            against = _made_of(technique, motion, objects, given)
        rows = technique.sample_offsets_px
        is_single = rows.shape[1] == 1
        is_elsewhere = jitter_px is not None or bool(rows.any())
        jitters = is_single and is_elsewhere and technique.reads_jitter
        if jitter_px is not None:
            count = np.shape(jitter_px)[:1] if poses is None else (len(poses),)
            _checks.shape("jitter_px", jitter_px, (*count, 2))
            _checks.all_in_range(
                "jitter_px", jitter_px, -_MOST_JITTER_PX, _MOST_JITTER_PX
            )
            rows = np.asarray(jitter_px)[:, None] if is_single else rows
        is_asked = jitters or against is not None
        samples_px = jnp.asarray(rows, dtype) if is_asked else None
        steps = objects if technique.reads_steps else None
        return cls(motion, against, steps, samples_px, jitters)

    def at(self, k: int) -> "Views":
        """Return that of frame k."""
        return jax.tree.map(lambda rows: rows[k % len(rows)], self)

    def along(self, frames: int) -> "Views":
        """Return those of a clip, a row per frame."""
        k = np.arange(frames)
        along = lambda rows: rows if len(rows) == frames else rows[k % len(rows)]
        return jax.tree.map(along, self)


def _made_of(
    technique: AbstractTechnique, motion: Motion, objects: Against | None, given: Given
) -> Against | None:
    """Find what velocity is made of; None is the head's turn alone."""
    found, what, read = objects, "objects move", ["depth", "object_id"]
    if objects is None:
        moved_m = motion.translation_m
        moves = moved_m is not None and (_checks.is_traced(moved_m) or np.any(moved_m))
        # Of a turn alone depth tells whose motion counts where surfaces meet.
        if not moves and "depth" not in technique.needs & set(given):
            return None
        moved_m = jnp.zeros_like(motion.offset) if moved_m is None else moved_m
        found, what, read = (motion.increment, moved_m), "the eye moves", ["depth"]
    if lacking := [name for name in read if name not in given]:
        raise ValueError(
            f"{technique.id} needs velocity, and {what}: give {_ways('velocity')}, or "
            f"{_ways(*lacking)}."
        )
    return found


def _ways(*channels: str) -> str:
    """Say how channels are given."""
    ways = [KEYWORDS[name] for name in channels]
    return " and ".join(f"{keyword}= ({option})" for keyword, option in ways)


def _against(motion: Motion, poses: Any, object_poses: Any) -> Against:
    """Increment and translation of the head against each object."""
    if _checks.is_traced(poses) or _checks.is_traced(object_poses):
        raise ValueError("poses and object_poses must be known while compiling.")
    if poses is None or poses.shape[1] != 7:
        raise ValueError(
            "poses must say where the eye is, (frames, 7), if there are object_poses."
        )
    objects = np.shape(object_poses)[1:2]
    _checks.shape("object_poses", object_poses, (len(poses), *objects, 7))
    found = np.asarray(object_poses, np.float64)
    _checks.all_in_range("object_poses", found)
    length = np.linalg.norm(found[..., :4], axis=-1)
    _checks.all_in_range("lengths of quaternions in object_poses", length, 0.99, 1.01)
    last = np.concatenate([found[:1], found[:-1]])
    turns, before = (
        Rotation.from_quat(each[..., :4].reshape(-1, 4), scalar_first=True)
        for each in (found, last)
    )
    # In the axes of the hold pose, in float64, as the head's own motion.
    hold = Rotation.from_quat(np.asarray(poses[0, :4], float), scalar_first=True).inv()
    own = [
        hold.apply(vectors.reshape(-1, 3)).reshape(*found.shape[:2], 3)
        for vectors in (
            found[..., 4:] - np.asarray(poses[0, 4:], float),
            (turns * before.inv()).as_rotvec(),
            found[..., 4:] - last[..., 4:],
        )
    ]
    of_objects = jax.vmap(against_object, in_axes=(None, 0, 0, 0))
    dtype = motion.offset.dtype
    return jax.jit(jax.vmap(of_objects))(motion, *(jnp.asarray(v, dtype) for v in own))


class Rendered(eqx.Module):
    """Frames that were rendered elsewhere: one, or a clip with a leading axis.

    - `color`: gamma, `(samples, 3, height, width)`.
    - `channels`: what is needed, or what a velocity is derived from.
    """

    color: Float[Array, "*frames samples 3 height width"]
    channels: Mapping[str, Shaped[Array, "*frames samples channels height width"]]
    static_mask: Bool[Array, "*frames height width"] | None = None

    def frame(
        self,
        technique: AbstractTechnique,
        camera: Camera,
        view: Views,
        reading: Reading = GATHER,
    ) -> Frame:
        """Return what a technique sees of one frame; `view`: that of the frame."""
        needs, place, jitter_px = technique.needs, view.samples_px, None
        channels = {name: each for name, each in self.channels.items() if name in needs}
        if place is not None:
            jitter_px = place[0] if view.jitters else None
            if view.against is not None:
                velocity = self._velocity(camera, place, *view.against)
                channels["velocity"] = velocity
        return Frame(
            self.color,
            camera,
            Region.whole(camera),
            self.static_mask,
            reading,
            channels,
            jitter_px=jitter_px,
            steps=view.steps,
        )

    def _velocity(
        self, camera: Camera, samples_px: Array, increment: Array, translation_m: Array
    ) -> Float[Array, "samples 2 height width"]:
        region, dtype = Region.whole(camera), increment.dtype
        x, y = (n.astype(dtype) + 0.5 for n in (region.columns(), region.rows()))
        ids = self.channels["object_id"] if increment.ndim > 1 else None

        def of_sample(depth: Array, object_id: Array | None, place: Array) -> Array:
            which = None if object_id is None else object_id[0]
            x_px, y_px, motion = x + place[0], y + place[1], (increment, translation_m)
            past = past_displacement(camera, x_px, y_px, depth[0], *motion, which)
            return -jnp.stack(past)

        return jax.vmap(of_sample)(self.channels["depth"], ids, samples_px)


def checked_channels(
    technique: AbstractTechnique,
    given: Given,
    views: Views,
    shape: tuple[int, ...],
    dtype: DTypeLike,
) -> dict[str, Shaped[Array, "frames samples channels height width"]]:
    """Check all channels that are given, and keep those that are read.

    **Arguments:** `shape`: of the frames without their colours: `(frames, height,
    width)`, or with samples `(frames, samples, height, width)`.

    **Errors:** `ValueError` for a wrong shape or range, and for what lacks.
    """
    needs = technique.needs
    for name in sorted(needs - {"color", "velocity", *given}):
        way = f": give {_ways(name)}" if name in KEYWORDS else ", which none has"
        raise ValueError(f"{technique.id} needs the frames' {name}{way}.")
    found = {name: checked(name, each, shape, dtype) for name, each in given.items()}
    read, classes = needs, found.get("motion_class", np.zeros(1))
    derives = "velocity" in needs - set(found)
    moves = views.steps or views.against
    if moves is not None and moves[0].ndim > 2:
        count, read = moves[0].shape[1], needs | {"depth", "object_id"}
        _checks.all_in_range(
            "object_id, a row of object_poses,", given["object_id"], 0, count - 1
        )
    elif technique.reads_steps:
        if not _checks.is_traced(classes) and (classes == _RIGID).any():
            raise ValueError(
                f"{technique.id} needs to know how objects move, and motion_class says "
                "that some are rigid: give object_poses=."
            )
    elif derives:
        read = needs if views.against is None else needs | {"depth"}
        if not _checks.is_traced(classes) and classes.any():
            raise ValueError(
                f"{technique.id} needs velocity, and motion_class says that objects "
                f"move: give {_ways('velocity')}, or object_poses=."
            )
    return {name: planes for name, planes in found.items() if name in read}


def checked(
    name: str, values: Any, shape: tuple[int, ...], dtype: DTypeLike
) -> Shaped[Array, "frames samples channels height width"]:
    """Check a channel as it is given, and return its planes.

    **Errors:** `ValueError` naming the keyword, what must be, and what is.
    """
    keyword, (planes, own) = KEYWORDS[name][0], CHANNELS[name]
    _checks.unmasked(keyword, values)
    values = values if isinstance(values, jax.Array) else np.asarray(values)
    _checks.shape(keyword, values, shape if planes == 1 else (*shape, planes))
    if name == "albedo":
        values = _checks.colors(keyword, values)
    elif own is not None:
        _checks.all_in_range(keyword, values, 0, _MOST[name])
        if not _checks.is_traced(values) and (off := values != np.rint(values)).any():
            raise ValueError(f"{keyword} must be whole numbers, got {values[off][0]}.")
    else:
        _checks.floating(keyword, values)
        if name == "velocity":
            _checks.all_in_range(keyword, values)
        elif not _checks.is_traced(values) and not (is_good := values > 0).all():
            raise ValueError(
                f"{keyword} must be above 0 (inf where there is nothing), m along -z, "
                f"got {values[~is_good][0]}."
            )
    found = jnp.asarray(values, own or dtype)
    found = jnp.moveaxis(found[..., None] if planes == 1 else found, -1, -3)
    return found[:, None] if len(shape) == 3 else found
