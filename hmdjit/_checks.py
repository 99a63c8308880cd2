"""Boundary checks with one message form: field, allowed range, value.

Values are checked where data enters. Inside compiled code a number is a tracer and
has no value yet: it passes, and what is wrong with it becomes NaN in the result.
"""

import difflib
import math
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


def number(value: Any) -> Any:
    """Convert to a Python float, but let arrays and tracers pass.

    Python floats stay weakly typed, so that a config follows its data's precision.
    """
    return value if isinstance(value, jax.Array) else float(value)


def numbers(values: Iterable[Any]) -> tuple[Any, ...]:
    """Convert each of several values as `number` does."""
    return tuple(number(value) for value in values)


def is_traced(value: Any) -> bool:
    """Whether a value is not known yet because a program is being traced."""
    return isinstance(value, Tracer)


def in_range(
    name: str,
    value: Any,
    low: float | int = -math.inf,
    high: float | int = math.inf,
    *,
    open_low: bool = False,
    open_high: bool = False,
) -> None:
    """Raise unless `low <= value <= high` (`<` at an open end); refuses NaN and inf.

    **Errors:** `ValueError` naming the field, the range and the value.
    """
    if is_traced(value):
        return
    above = value > low if open_low else value >= low
    below = value < high if open_high else value <= high
    if not (math.isfinite(value) and above and below):
        left = "(" if open_low or low == -math.inf else "["
        right = ")" if open_high or high == math.inf else "]"
        raise ValueError(
            f"{name} must lie in {left}{_written(low)}, {_written(high)}{right}, "
            f"got {_written(value, low, high)}."
        )


def all_in_range(
    name: str, values: Any, low: float | int = -math.inf, high: float | int = math.inf
) -> None:
    """Raise unless all numbers are finite and within a range; names the first."""
    if not is_traced(values):
        values = np.asarray(values)
        good = np.isfinite(values) & (values >= low) & (values <= high)
        for wrong in values[~good][:1]:
            in_range(name, wrong, low, high)


def shape(name: str, values: Any, sizes: tuple[int, ...]) -> None:
    """Raise unless an array has a shape."""
    if np.shape(values) != sizes:
        found = tuple(np.shape(values))
        raise ValueError(f"{name} must have the shape {sizes}, got {found}.")


def _written(value: Any, *bounds: Any) -> str:
    return str(value) if isinstance(value, int) else apart(value, *bounds)


def apart(value: Any, *bounds: Any, spec: str = "6g") -> str:
    """Write a number, with more digits where it would read as a bound that it misses.

    **Arguments:** `spec`: least digits, and how they are counted: `6g`, `2f`.
    """
    missed = [float(bound) for bound in bounds if bound != value]
    for digits in range(int(spec[:-1]), 18):
        form = f".{digits}{spec[-1]}"
        text = format(float(value), form)
        if text not in [format(bound, form) for bound in missed]:
            return text
    return repr(float(value))


def colors(name: str, values: Any) -> jax.Array:
    """Gamma colours as floats in `[0, 1]`: codes of 8 or 16 bits by 255 or 65535.

    **Errors:** `ValueError` for any other dtype that is not floating, and for floats
    outside `[0, 1]` by more than half a code value of 8 bits, and for masked arrays;
    what is not finite or is being traced passes.
    """
    unmasked(name, values)
    values = values if isinstance(values, jax.Array) else np.asarray(values)
    if values.dtype in (np.uint8, np.uint16):
        return jnp.asarray(values, float) / float(jnp.iinfo(values.dtype).max)
    floating(name, values, "uint8, uint16 or floating in [0, 1]")
    if not is_traced(values):
        known = np.asarray(values)
        finite = np.isfinite(known)
        low = float(known.min(initial=np.inf, where=finite))
        high = float(known.max(initial=-np.inf, where=finite))
        if low < -0.5 / 255 or high > 1 + 0.5 / 255:
            raise ValueError(
                f"{name} must lie in [0, 1], "
                f"got {values.dtype} from {low:g} to {high:g}."
            )
    return jnp.asarray(values)


def unmasked(name: str, values: Any) -> None:
    """Raise for a masked array: what lies under its mask would count."""
    if isinstance(values, np.ma.MaskedArray):
        raise ValueError(f"{name} must not be masked: say what is there by filled().")


def floating(name: str, values: Any, allowed: str = "floating") -> None:
    """Raise unless numbers are floating: whole ones would wrap around."""
    if not jnp.issubdtype(values.dtype, jnp.floating):
        raise ValueError(f"{name} must be {allowed}, got {values.dtype}.")


def whole(name: str, value: Any, low: int) -> None:
    """Raise unless `value` is a whole number of at least `low`."""
    if is_traced(value):
        raise ValueError(
            f"{name} must be a whole number >= {low} that is known while compiling, "
            "got a traced one: name it in static_argnames."
        )
    if (
        isinstance(value, bool)
        or not isinstance(value, int | np.integer)
        or value < low
    ):
        raise ValueError(f"{name} must be a whole number >= {low}, got {value!r}.")


def boolean(name: str, value: Any) -> None:
    """Raise unless a value is True or False: a word, or None, would pass as one."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} must be True or False, got {value!r}.")


def random_key(key: Any) -> None:
    """Raise unless a value is one random key of JAX's, of the new style or the old."""
    dtype, shape = getattr(key, "dtype", None), getattr(key, "shape", None)
    is_new = dtype is not None and jnp.issubdtype(dtype, jax.dtypes.prng_key)
    is_old = dtype == np.uint32 and shape in ((2,), (4,))
    if not ((is_new and shape == ()) or is_old):
        raise ValueError(
            f"key must be one random key, as jax.random.key(0) gives, got "
            f"{' '.join(repr(key).split())}."
        )


def known_keys(keys: Iterable[str], known: Iterable[str], prefix: str = "") -> None:
    """Raise unless all `keys` are `known`; suggests the nearest, or names all."""
    known = list(known)
    for key in keys:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"Known are {', '.join(known)}." if known else "None is known here."
            hint = f"Did you mean {prefix}{near[0]}?" if near else hint
            raise ValueError(f"unknown key {prefix}{key}. {hint}")


def one_of(name: str, value: str, allowed: Iterable[str]) -> None:
    """Raise unless `value` is one of `allowed`; suggests the nearest of them."""
    allowed = list(allowed)
    if value not in allowed:
        near = difflib.get_close_matches(str(value), allowed, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise ValueError(
            f"{name} must be one of {', '.join(allowed)}, got {value!r}.{hint}"
        )
