"""Sessions on all devices: each takes its share, one session after the other."""

import contextlib
import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec

from ..frames.sources import AbstractSource

_FASTER: dict[str, bool | int | str] = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_cpu_copy_insertion_use_region_analysis": True,
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 2,
}
_FASTER_RAYS: dict[str, bool | int | str] = {
    "xla_cpu_prefer_vector_width": 512,
    "xla_backend_optimization_level": 1,
}
"""Without the emitters that are left out above, casting rays takes thrice as long."""


@functools.cache
def compiler_options(casts_rays: bool = False) -> dict[str, bool | int | str]:
    """Return what makes sessions on a CPU a tenth faster and sooner compiled.

    Measured with JAX 0.10; what another version does not know is left out. JAX takes
    options only for programs that no other one calls.
    """
    if jax.default_backend() != "cpu":
        return {}
    known = {}
    for name, value in (_FASTER_RAYS if casts_rays else _FASTER).items():
        with contextlib.suppress(jax.errors.JaxRuntimeError):
            jax.jit(lambda: 0, compiler_options={name: value})()
            known[name] = value
    return known


def mesh() -> Mesh:
    """All devices in a row, among which sessions are shared out."""
    return Mesh(np.array(jax.devices()), ("sessions",))


Source = TypeVar("Source", bound=AbstractSource)


def placed(source: Source) -> Source:
    """Copy a source to every device, or each dispatch copies it anew."""

    def single(leaf: Any) -> Any:
        # With float64 in another thread, JAX would place NumPy's as it is.
        if not isinstance(leaf, np.ndarray):
            return leaf
        return leaf.astype(jax.dtypes.canonicalize_dtype(leaf.dtype))

    return jax.device_put(jax.tree.map(single, source), NamedSharding(mesh(), Spec()))


def over_devices(
    one: Callable[[Any, Any], Any], shared: Any, items: Any, mesh: Mesh
) -> Any:
    """Apply a function to each item; a device maps over its own one by one.

    **Arguments:**

    - `one`: takes what all items share, and one item.
    - `shared`, `items`: any trees; the arrays of `items` have a leading axis.
    """

    def many(shared: Any, items: Any) -> Any:
        return jax.lax.map(lambda item: one(shared, item), items)

    count = jax.tree.leaves(items)[0].shape[0]
    each = -(-count // mesh.size)
    if each * mesh.size > count:  # each device is given as many
        repeated = np.arange(each * mesh.size, dtype=np.int32) % count
        items = jax.tree.map(lambda leaf: leaf[repeated], items)
    split = Spec(mesh.axis_names)
    found = jax.shard_map(
        many, mesh=mesh, in_specs=(Spec(), split), out_specs=split, check_vma=False
    )(shared, items)
    return jax.tree.map(lambda leaf: leaf[:count], found)


class Program:
    """A function compiled with the `compiler_options`, for no other one to call.

    They are asked for when it is first called: they depend on the platform.
    """

    def __init__(self, function: Callable, *static: str, casts_rays: bool = False):
        functools.update_wrapper(self, function)
        self._function, self._static = function, static
        self._casts_rays = casts_rays

    @functools.cached_property
    def jitted(self) -> Any:
        """The compiled function."""
        return jax.jit(
            self._function,
            static_argnames=self._static,
            compiler_options=compiler_options(self._casts_rays),
        )

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the compiled function."""
        return self.jitted(*arguments, **named)


def program(*static: str) -> Callable[[Callable], Program]:
    """Decorate a function to be compiled as a `Program`; `static` names arguments."""
    return lambda function: Program(function, *static)


def _over_sessions(
    shared: Any,
    items: Any,
    *,
    one: Callable[..., Any],
    static: tuple[tuple[str, Any], ...],
    mesh: Mesh,
) -> Any:
    return over_devices(functools.partial(one, **dict(static)), shared, items, mesh)


_STATIC = ("one", "static", "mesh")
_PROGRAMS = {
    casts_rays: Program(_over_sessions, *_STATIC, casts_rays=casts_rays)
    for casts_rays in (False, True)
}


def over_sessions(
    one: Callable[..., Any],
    shared: Any,
    items: Any,
    *,
    casts_rays: bool = False,
    **static: Any,
) -> Any:
    """Apply a function to each session, on all devices, in one compiled program.

    **Arguments:**

    - `one`: takes what all sessions share, one session's item, and `static` by name;
      a function of a module, for a new one is compiled anew.
    - `shared`, `items`: any trees; the arrays of `items` have a leading axis.
    - `casts_rays`: whether that is most of the work.
    - `static`: hashable.
    """
    pairs = tuple(sorted(static.items()))
    run = _PROGRAMS[casts_rays]
    return run(shared, items, one=one, static=pairs, mesh=mesh())
