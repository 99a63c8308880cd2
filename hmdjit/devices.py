"""Work on all devices: each takes its share, one item after the other."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec

from .sources import Texture

COMPILER_OPTIONS: dict[str, bool | int | str] = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_cpu_copy_insertion_use_region_analysis": True,
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 2,
}
"""What makes sessions on a CPU a tenth faster, and compiles them in two thirds of the
time; measured with JAX 0.10. JAX takes options for programs that no other one calls."""


def mesh() -> Mesh:
    """All devices, in a row."""
    return Mesh(np.array(jax.devices()), ("items",))


def placed(texture: Texture) -> Texture:
    """Copy a texture to every device, or each dispatch copies it anew."""
    return jax.device_put(texture, NamedSharding(mesh(), Spec()))


def over_devices(
    one: Callable[[Any, Any], Any], shared: Any, items: Any, mesh: Mesh
) -> Any:
    """Apply a function to each item; a device maps over its own one by one.

    **Arguments:**

    - `one`: of what all items share and of one item.
    - `items`: arrays with a leading axis, as long as a multiple of the devices.
    """

    def many(shared: Any, items: Any) -> Any:
        return jax.lax.map(lambda item: one(shared, item), items)

    split = Spec(mesh.axis_names)
    return jax.shard_map(
        many, mesh=mesh, in_specs=(Spec(), split), out_specs=split, check_vma=False
    )(shared, items)
