"""Sessions on all devices: each takes its share, one session after the other."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec

from ..sources import Texture


def mesh() -> Mesh:
    """All devices, in a row."""
    return Mesh(np.array(jax.devices()), ("sessions",))


def placed(texture: Texture) -> Texture:
    """Copy a texture to every device, or each dispatch copies it anew."""
    return jax.device_put(texture, NamedSharding(mesh(), Spec()))


def over_sessions(
    one: Callable[[Any, Any], Any], shared: Any, per_session: Any, mesh: Mesh
) -> Any:
    """Apply a function to each session; a device maps over its own one by one.

    **Arguments:**

    - `one`: of what all sessions share and what one session has.
    - `per_session`: arrays with a leading session axis, a multiple of the devices.
    """

    def many(shared: Any, per_session: Any) -> Any:
        return jax.lax.map(lambda mine: one(shared, mine), per_session)

    split = Spec("sessions")
    return jax.shard_map(
        many, mesh=mesh, in_specs=(Spec(), split), out_specs=split, check_vma=False
    )(shared, per_session)
