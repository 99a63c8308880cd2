"""The task as hmdjit does it: the adapter between the benchmark and the package."""

import math
import sys
from collections.abc import Callable, Collection
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from machine import cpus
from scipy.spatial.transform import Rotation
from serving import Run, serve
from task import CLOSENESS, FOCAL_PX, H_MAX_DEG_S, REFRESH_HZ, W_LB, W_MIN, Task

from hmdjit import Camera, Motion, Region, Texture
from hmdjit.frames.motion import rebased_motion
from hmdjit.metrics import MTCD, STANDARD
from hmdjit.simulation.session import fastest_reading, session
from hmdjit.simulation.sharding import compiler_options, over_devices
from hmdjit.techniques import HeadMovement

MARGIN_PX = 16
ADDITIONS = ("mask", "fine", "loss")
"""What hmdjit's own studies do beyond the task: the current picture where the past one
lies outside the camera frame, two texels per pixel, and detail loss."""


class Unmasked(HeadMovement):
    """The past's edge is repeated outside the camera frame, as rivals do."""

    def has_past(self, frame, past):
        """Everywhere."""
        return jnp.ones((frame.region.height, frame.region.width), bool)


Arguments = tuple[Texture, Camera, HeadMovement, Region, Motion]


def arguments(task: Task, additions: Collection[str] = ()) -> Arguments:
    """Everything that the program is called with."""
    side = task.shape[2]
    fov_deg = 2 * math.degrees(math.atan(side / 2 / FOCAL_PX))
    camera = Camera(side, side, fov_deg, REFRESH_HZ)
    margin = ((MARGIN_PX, MARGIN_PX), (MARGIN_PX, MARGIN_PX), (0, 0))
    texels = np.pad(task.texture, margin, mode="edge")
    if "fine" in additions:
        texels = refined(texels)
    k = len(texels) // (side + 2 * MARGIN_PX)
    texels = jnp.asarray(texels)
    texture = Texture.of(texels, texels, oversampling=k, margin_px=MARGIN_PX)
    kind = HeadMovement if "mask" in additions else Unmasked
    technique = kind(W_MIN, W_LB, H_MAX_DEG_S, (CLOSENESS,))
    poses = Rotation.from_rotvec(task.poses.reshape(-1, 3)).as_quat(scalar_first=True)
    paths = poses.reshape(*task.shape[:2], 4)
    motions = [rebased_motion(path, jnp.float32) for path in paths]
    motion = jax.tree.map(lambda *leaves: jnp.stack(leaves), *motions)
    return texture, camera, technique, Region.whole(camera), motion


def refined(picture: np.ndarray) -> np.ndarray:
    """Twice the texels of a picture that reads the same between them."""
    for axis in (0, 1):
        last = np.take(picture, [-1], axis)
        after = np.concatenate([np.delete(picture, 0, axis), last], axis)
        pairs = np.stack([picture, (picture + after) / 2], axis + 1)
        shape = [2 * n if i == axis else n for i, n in enumerate(picture.shape)]
        picture = pairs.reshape(shape)
    return picture


def _measure(
    texture: Texture,
    camera: Camera,
    technique: HeadMovement,
    region: Region,
    motion: Motion,
    *,
    mesh: Mesh,
    loss: bool,
) -> tuple[jax.Array, ...]:
    def one(shared: tuple, motion: Motion) -> tuple[jax.Array, ...]:
        texture, camera, technique, region = shared
        (result,) = session(
            texture,
            camera,
            (technique,),
            motion,
            region,
            region,
            warmup=0,
            reading=fastest_reading(),
            metrics=STANDARD if loss else (MTCD(),),
        )
        return tuple(map(jnp.asarray, result.metrics.values()))

    shared = (texture, camera, technique, region)
    return over_devices(one, shared, motion, mesh)


def compiled(
    given: Arguments, additions: Collection[str] = ()
) -> Callable[[Arguments], np.ndarray]:
    """Compile for these shapes; sessions are split over the devices."""
    sessions = len(given[-1].offset)
    devices = jax.devices()[: math.gcd(sessions, len(jax.devices()))]
    mesh = Mesh(np.array(devices), ("sessions",))
    static, options = ("mesh", "loss"), compiler_options()
    measure = jax.jit(_measure, static_argnames=static, compiler_options=options)
    program = measure.lower(*given, mesh=mesh, loss="loss" in additions).compile()
    return lambda given: np.asarray(program(*given)[0])


def build(task: Task, additions: Collection[str] = ()) -> Run:
    """A device per core."""
    given = arguments(task, additions)
    program = compiled(given, additions)
    return lambda: program(given)


def use_all_cores() -> None:
    """Give each core a device; before JAX looks for them."""
    jax.config.update("jax_num_cpu_devices", len(cpus()))


if __name__ == "__main__":
    use_all_cores()
    serve(partial(build, additions=sys.argv[1:]))
