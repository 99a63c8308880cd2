"""What a scene is, how a stored picture is read, and how a scene is baked to a texture.

A scene is a function from a direction in the head frame of the *hold pose* (x right,
y up, -z forward) to a gamma colour. Flat scenes are painted on the plane z = -1, the
image plane of the hold pose: a point of it is `(x, y)`, right and up, in tangent units,
each `camera.focal_px` display pixels. A size in degrees is one at the centre, where a
degree is pi / 180 tangent units (8.05 px with the default camera).
"""

import abc
import copy
import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..camera import Camera
from ..frames.texture import PICTURE

Directions = Float[Array, "3 *size"]
Colors = Float[Array, "3 *size"]
Coordinate = Float[Array, "*size"]


class AbstractScene(eqx.Module):
    """A static world that fills the view, seen from a head that only turns.

    Everything that decides the picture is a field: numbers and texels are leaves.

    - `name`: what tables call it; static, as all fields that are no numbers.

    **Errors:** `ValueError` naming a field of text that is not static.
    """

    name: eqx.AbstractVar[str]

    def __check_init__(self):
        for path, leaf in jax.tree_util.tree_leaves_with_path(self):
            if isinstance(leaf, str):
                field = jax.tree_util.keystr(path).removeprefix(".")
                raise ValueError(f"{field} must be static: eqx.field(static=True).")

    @property
    def gives(self) -> frozenset[str]:
        """Channels that techniques may ask for."""
        return PICTURE

    @abc.abstractmethod
    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour seen along a direction: one exact point, no anti-aliasing.

        **Arguments:** `direction`: head frame of the hold pose, any length but 0, shape
        `(3, *size)`.

        **Returns:** in `[0, 1]`, shape `(3, *size)`, dtype of `direction`.
        """


class AbstractFlatScene(AbstractScene):
    """A scene painted on the image plane of the hold pose."""

    @abc.abstractmethod
    def plane_color(self, camera: Camera, x: Coordinate, y: Coordinate) -> Colors:
        """Gamma colour at `(x, y)` of the plane z = -1, tangent units."""

    def color(self, camera: Camera, direction: Directions) -> Colors:
        """Gamma colour where the direction meets the plane; NaN where it does not."""
        depth = -direction[2]
        in_front = depth > 0
        safe = jnp.where(in_front, depth, 1.0)
        colors = self.plane_color(camera, direction[0] / safe, direction[1] / safe)
        return jnp.where(in_front[None], colors, jnp.nan)


def nameless(scene: AbstractScene) -> AbstractScene:
    """Copy a scene without its name, so that those of one class share a program."""
    copied = copy.copy(scene)
    if any(field.name == "name" for field in dataclasses.fields(scene)):
        object.__setattr__(copied, "name", "")  # as its own `__init__` may not do
    return copied


def check_scene(scene: Any, camera: Camera, name: str = "") -> None:
    """Raise unless a scene is one, and gives colours of the shape that it must.

    Nothing is computed: its function is traced, once for scenes of one class and shape.

    **Arguments:** `name`: what messages call it; by default its own name.

    **Errors:** `ValueError` naming the scene and what it must return.
    """
    if not isinstance(scene, AbstractScene):
        called = f"scene {name!r}" if name else "scene"
        itself = getattr(scene, "__name__", None)  # a class, or a function
        got = f"{itself} itself" if itself else f"an instance of {type(scene).__name__}"
        raise ValueError(
            f"{called} must be an instance of a subclass of hj.scenes.AbstractScene, "
            f"got {got}."
        )
    method, size = "color(camera, direction)", "direction[0].shape"
    if isinstance(scene, AbstractFlatScene):
        method, size = "plane_color(camera, x, y)", "x.shape"
    must = (
        f"scene {name or scene.name!r}: {method} must return colours in [0, 1] of the "
        f"shape (3, *{size})"
    )
    direction = jax.ShapeDtypeStruct((3, 2, 5), jnp.result_type(float))
    try:
        color, own = _returned.eval_shape(nameless(scene), camera, direction)
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        raise ValueError(f"{must}, got {type(error).__name__}: {reason}") from error
    is_fit = isinstance(color, jax.ShapeDtypeStruct) and color.shape == direction.shape
    if not is_fit or not jnp.issubdtype(color.dtype, jnp.floating):
        shape = getattr(own, "shape", None)
        got = type(own).__name__ if shape is None else f"{own.dtype} of shape {shape}"
        raise ValueError(f"{must}, got {got} for (2, 5) directions.")


@jax.jit
def _returned(scene: AbstractScene, camera: Camera, direction: Directions) -> tuple:
    """Return what is seen, and what the scene's own method made of it."""
    color = scene.color(camera, direction)
    if not isinstance(scene, AbstractFlatScene):
        return color, color
    return color, scene.plane_color(camera, direction[0], direction[1])
