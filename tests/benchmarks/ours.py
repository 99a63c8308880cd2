"""The task as hmdjit does it: the adapter between the benchmark and the package."""

import math
from collections.abc import Callable
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
from hmdjit.frame import rebased_motion
from hmdjit.session import fastest_reading, session
from hmdjit.studies.devices import over_sessions
from hmdjit.techniques import HeadMovement

MASKED = True
"""Whether the past outside the camera frame is replaced by the current picture."""

DETAIL_LOSS = False
"""Whether to measure detail loss too; rivals do not."""

MARGIN_PX = 16
COMPILER_OPTIONS: dict[str, bool | int | str] = {"xla_cpu_prefer_vector_width": 512}

Arguments = tuple[Texture, Camera, HeadMovement, Region, Motion]


def arguments(task: Task) -> Arguments:
    """Everything that the program is called with."""
    side = task.shape[2]
    fov_deg = 2 * math.degrees(math.atan(side / 2 / FOCAL_PX))
    camera = Camera(side, side, fov_deg, REFRESH_HZ)
    margin = ((MARGIN_PX, MARGIN_PX), (MARGIN_PX, MARGIN_PX), (0, 0))
    texels = jnp.asarray(np.pad(task.texture, margin, mode="edge"))
    texture = Texture.of(texels, texels, oversampling=1, margin_px=MARGIN_PX)
    technique = HeadMovement(W_MIN, W_LB, H_MAX_DEG_S, (CLOSENESS,))
    poses = Rotation.from_rotvec(task.poses.reshape(-1, 3)).as_quat(scalar_first=True)
    paths = poses.reshape(*task.shape[:2], 4)
    motions = [rebased_motion(path, jnp.float32) for path in paths]
    motion = jax.tree.map(lambda *leaves: jnp.stack(leaves), *motions)
    return texture, camera, technique, Region.whole(camera), motion


@partial(jax.jit, static_argnames="mesh", compiler_options=COMPILER_OPTIONS)
def _measure(
    texture: Texture,
    camera: Camera,
    technique: HeadMovement,
    region: Region,
    motion: Motion,
    *,
    mesh: Mesh,
) -> tuple[jax.Array, ...]:
    def one(shared: tuple, motion: Motion) -> tuple[jax.Array, ...]:
        texture, camera, technique, region = shared
        result = session(
            texture,
            camera,
            technique,
            motion,
            region,
            region,
            warmup=0,
            reading=fastest_reading(),
            detail_loss=DETAIL_LOSS,
        )
        return (jnp.asarray(result.mtcd), jnp.asarray(result.detail_loss))

    shared = (texture, camera, technique, region)
    return over_sessions(one, shared, motion, mesh)


def compiled(given: Arguments) -> Callable[[Arguments], np.ndarray]:
    """Compile for these shapes; sessions are split over the devices."""
    sessions = len(given[-1].offset)
    devices = jax.devices()[: math.gcd(sessions, len(jax.devices()))]
    mesh = Mesh(np.array(devices), ("sessions",))
    program = _measure.lower(*given, mesh=mesh).compile()
    return lambda given: np.asarray(program(*given)[0])


def build(task: Task) -> Run:
    """A device per core."""
    given = arguments(task)
    program = compiled(given)
    return lambda: program(given)


def use_all_cores() -> None:
    """Give each core a device; before JAX looks for them."""
    jax.config.update("jax_num_cpu_devices", len(cpus()))


if __name__ == "__main__":
    use_all_cores()
    serve(build)
