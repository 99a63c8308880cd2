"""The numerical envelope: how right each public function is, and over which range.

A *row* of the table is a function, its exact answer, and the ranges of its arguments,
spread over a logarithmic scale with the extremes among them. Values are held against
the answer in 300 digits (mpmath), and gradients, by reverse and by forward
differentiation, against its central differences. A *measurement* is the largest error
of a row in one dtype, with the inputs that give it, and its bound.
"""

import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .row import DTYPES, Inputs, Row, Sized, mp

DIGITS = 300
_STEP = mp.mpf(10) ** -45  # central differences err by the square, and cancel as much
_LEAST_STEP = 1e-195  # of numbers of size 1 it leaves 100 digits
_NOISE = 1e-100  # what differences of 300 digits are sure to


class Measurement(NamedTuple):
    """What was found of a row in one dtype.

    `error` is the largest in `unit`, that of the gradient in eps: NaN where there is
    none, infinite where one is no number. `absolute` and `relative` are the largest
    such errors; `worst`, `worst_gradient` the inputs that give them, of `inputs` many.
    """

    name: str
    over: str
    dtype: str
    unit: str
    error: float
    bound: float
    absolute: float
    relative: float
    gradient: float
    gradient_bound: float
    worst: str
    worst_gradient: str
    inputs: int
    seed: int

    @property
    def holds(self) -> bool:
        """Whether both bounds hold."""
        return self.error <= self.bound and not self.gradient > self.gradient_bound


def measure(
    rows: Sequence[Row],
    *,
    seed: int = 0,
    quick: bool = False,
    progress: Callable[[Measurement], None] = lambda found: None,
) -> list[Measurement]:
    """Measure every row in every dtype that it has a bound for.

    The quick form has float32 only, and of each row the few inputs that it states.
    """
    found = []
    for row in rows:
        for dtype in row.bounds:
            if not quick or (row.quick and dtype == DTYPES[0]):
                found.append(measure_row(row, dtype, seed=seed, quick=quick))
                progress(found[-1])
    return found


def measure_row(
    row: Row, dtype: str, *, seed: int = 0, quick: bool = False
) -> Measurement:
    """Measure a row in one dtype; inputs depend on seed and name alone.

    Runs under float64, as a local choice: what is float32 stays so.
    """
    with jax.enable_x64(True), mp.workdps(DIGITS):
        rng = np.random.default_rng([seed, zlib.crc32(row.name.encode())])
        inputs, bound = row.inputs(rng, np.dtype(dtype)), row.bounds[dtype]
        if quick and len(inputs) > row.quick:
            # Evenly, but not every second one: kinds of inputs alternate.
            places = np.linspace(0, len(inputs) - 1, row.quick).astype(int)
            inputs = [inputs[n] for n in places]
        floating = [i for i, x in enumerate(inputs[0]) if _is_floating(x)]
        wrt = tuple(floating if row.wrt is None else row.wrt)
        wrt = () if math.isnan(bound.gradient) else wrt
        evaluated = _evaluated(row, inputs, wrt, quick)
        each = [
            _errors(row, np.finfo(dtype), arguments, wrt, *found)
            for arguments, found in zip(inputs, evaluated, strict=True)
        ]
    worst = (max(kind, key=lambda error: error[0]) for kind in zip(*each, strict=True))
    (error, where), (absolute, _), (relative, _), (gradient, place) = worst
    gradient = gradient if wrt else math.nan
    most, steepest = map(float, bound)
    numbers = (error, most, absolute, relative, gradient, steepest)
    named = row.name, row.over, dtype, row.unit
    return Measurement(*named, *numbers, where, place, len(inputs), seed)


def _evaluated(row: Row, inputs: list[Inputs], wrt: tuple, quick: bool) -> list[tuple]:
    """Values of all inputs; by argument, reverse and (unless quick) forward slopes."""
    if row.eager:
        return [(np.ravel(row.function(*arguments)), []) for arguments in inputs]
    flat = lambda *arguments: jnp.ravel(row.function(*arguments))

    @jax.jit
    @jax.vmap
    def all_of(*arguments: Any) -> tuple[Any, ...]:
        by = [jax.jacrev, jax.jacfwd][: 2 - quick] if wrt else []
        jacobians = [jacobian(flat, wrt)(*arguments) for jacobian in by]
        return flat(*arguments), list(zip(*jacobians, strict=True))

    batch = [jnp.asarray(np.stack(column)) for column in zip(*inputs, strict=True)]
    found = jax.tree.map(np.asarray, all_of(*batch))
    return [jax.tree.map(lambda x, n=n: x[n], found) for n in range(len(inputs))]


def _errors(
    row: Row, number: Any, arguments: Inputs, wrt: tuple, ours: Any, jacobians: list
) -> list[tuple[float, str]]:
    """Judged, absolute and relative error of a value, and error of the gradient."""
    exact = [exact_numbers(x) for x in arguments]
    least = max(float(number.tiny / number.eps), _NOISE**2)
    answer = row.oracle(*exact)
    is_sized = isinstance(answer, Sized)
    values = answer.values if is_sized else answer
    finite = [abs(x) for x in values if mp.isfinite(x)]
    sizes = answer.sizes if is_sized else [max(finite, default=0)] * len(values)
    sizes = [max(size, row.floor, least) for size in sizes]
    gaps = distances(ours, values)
    relative = max(gap / size for gap, size in zip(gaps, sizes, strict=True))
    kinds = {"eps": relative / number.eps, "relative": relative}
    where, worst = describe(arguments), [(0.0, "")]
    for i, slopes in zip(wrt, jacobians, strict=True):
        if row.kink and row.kink(*arguments):
            is_finite = all(np.isfinite(slope).all() for slope in slopes)
            worst.append((0.0 if is_finite else math.inf, where))
            continue
        unit = row.slope_unit(arguments, i) if row.slope_unit else 0.0
        floor = [size / max(unit, number.tiny) if unit else 0 for size in sizes]
        truth = _slope(row.oracle, exact, i)
        largest = np.abs(truth) if is_sized else np.max(np.abs(truth))
        divisor = np.maximum(largest, np.maximum(np.c_[floor], least))
        for slope in slopes:
            gap = np.reshape(distances(slope, truth.ravel()), truth.shape)
            error = np.max(gap / divisor / number.eps)
            error = _float(error * (error > _NOISE))
            worst.append((error, f"{where}; by argument {i}"))
    judged = kinds.get(row.unit, max(gaps))
    errors = [(_float(x), where) for x in (judged, max(gaps), relative)]
    return [*errors, max(worst)]


_float = lambda error: math.inf if mp.isnan(error) else float(error)
_is_floating = lambda argument: getattr(argument, "dtype", np.dtype(int)).kind == "f"


def exact_numbers(argument: Any) -> Any:
    """Exactly the same numbers in mpmath; what is not floating stays as it is."""
    if not _is_floating(argument):
        return argument
    numbers = [mp.mpf(float(x)) for x in np.ravel(argument)]
    return np.array([*numbers, None], object)[:-1].reshape(argument.shape)[()]


def distances(ours: Any, exact: Any) -> list:
    """Difference of each entry; infinite where only one of them is a number."""
    gaps = []
    for x, y in zip(np.ravel(ours).tolist(), exact, strict=True):
        is_right = math.isnan(x) if mp.isnan(y) else x == y
        has_gap = not is_right and math.isfinite(x) and mp.isfinite(y)
        gaps.append(abs(x - y) if has_gap else mp.mpf(0) if is_right else mp.inf)
    return gaps


def _slope(oracle: Callable, arguments: list, index: int) -> np.ndarray:
    """Jacobian by one argument, `(answer, entries)`, by central differences."""
    argument = np.asarray(arguments[index], object)
    every = [abs(x) for a in arguments for x in np.ravel(a) if isinstance(x, mp.mpf)]
    smallest = min((x for x in every if x and mp.isfinite(x)), default=mp.mpf(1))
    columns = []
    for place in np.ndindex(argument.shape):
        size = abs(argument[place])
        size = size if size and mp.isfinite(size) else smallest
        step, sides = max(size * _STEP, _LEAST_STEP), []
        for move in (step, -step):
            moved = argument.copy()
            moved[place] += move
            found = oracle(*arguments[:index], moved[()], *arguments[index + 1 :])
            sides.append(found.values if isinstance(found, Sized) else found)
        pairs = zip(*sides, strict=True)
        columns.append([(ahead - behind) / (2 * step) for ahead, behind in pairs])
    return np.array(columns, object).T


def describe(arguments: Inputs) -> str:
    """Write inputs in one line; small arrays so that they can be typed in again."""
    texts = []
    for x in arguments:
        if isinstance(x, np.ndarray | np.generic):
            ends = f"{float(np.min(x))!r} to {float(np.max(x))!r}"
            x = x.tolist() if x.size <= 100 else f"{x.shape} numbers, {ends}"
        texts.append(" ".join(str(x).split()))
    return " ".join(texts)
