"""The numerical envelope: how right each public function is, and over which range.

A *row* of the table is a function, its exact answer, and the ranges of its arguments,
spread over a logarithmic scale with the extremes among them. Values are held against
the answer in 300 digits (mpmath), and gradients, by reverse and by forward
differentiation, against its central differences. A *measurement* is the largest error
of a row in one dtype, with the inputs that give it, and its bound.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
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
    rows: Sequence[Row], *, seed: int = 0, quick: bool = False
) -> Iterator[Measurement]:
    """Measure every row in every dtype that it has a bound for.

    The quick form has float32 only, and of each row the few inputs that it states.
    """
    for row in rows:
        for dtype in row.bounds:
            if not quick or (row.quick and dtype == DTYPES[0]):
                yield measure_row(row, dtype, seed=seed, quick=quick)


def measure_row(
    row: Row, dtype: str, *, seed: int = 0, quick: bool = False
) -> Measurement:
    """Measure a row in one dtype; inputs depend on seed and name alone.

    Runs under float64, as a local choice: what is float32 stays so.
    """
    with jax.enable_x64(True), mp.workdps(DIGITS):
        rng = np.random.default_rng([seed, zlib.crc32(row.name.encode())])
        inputs, (bound, steepest) = row.inputs(rng, np.dtype(dtype)), row.bounds[dtype]
        if quick and len(inputs) > row.quick:
            # Evenly, but not every second one: kinds of inputs alternate.
            places = np.linspace(0, len(inputs) - 1, row.quick).astype(int)
            inputs = [inputs[n] for n in places]
        wrt = tuple(i for i, x in enumerate(inputs[0]) if _is_floating(x))
        wrt = () if math.isnan(steepest) else row.wrt or wrt
        found = zip(inputs, *_evaluated(row, inputs, wrt, quick), strict=True)
        each = [_errors(row, np.finfo(dtype), wrt, *one) for one in found]
    worst = [max(kind, key=lambda error: error[0]) for kind in zip(*each, strict=True)]
    (error, where), (absolute, _), (relative, _), (gradient, place) = worst
    slopes = gradient if wrt else math.nan, float(steepest)
    numbers = error, float(bound), absolute, relative, *slopes
    named = row.name, row.over, dtype, row.unit
    return Measurement(*named, *numbers, where, place, len(inputs), seed)


def _evaluated(row: Row, inputs: list[Inputs], wrt: tuple, quick: bool) -> tuple:
    """Values of all inputs; by argument, reverse and (unless quick) forward slopes."""
    if row.eager:
        values = [np.ravel(row.function(*arguments)) for arguments in inputs]
        return values, [[]] * len(inputs)
    flat = lambda *arguments: jnp.ravel(row.function(*arguments))

    @jax.jit
    @jax.vmap
    def all_of(*arguments: Any) -> tuple[Any, ...]:
        by = [jax.jacrev, jax.jacfwd][: 2 - quick] if wrt else []
        jacobians = [jacobian(flat, wrt)(*arguments) for jacobian in by]
        return flat(*arguments), list(zip(*jacobians, strict=True))

    batch = [jnp.asarray(np.stack(column)) for column in zip(*inputs, strict=True)]
    values, slopes = jax.tree.map(np.asarray, all_of(*batch))
    at = lambda n: jax.tree.map(lambda slope: slope[n], slopes)
    return values, [at(n) for n in range(len(inputs))]


def _errors(
    row: Row, number: Any, wrt: tuple, arguments: Inputs, ours: Any, jacobians: list
) -> list[tuple[float, str]]:
    """Judged, absolute and relative error of a value, and error of the gradient."""
    exact = [exact_numbers(x) for x in arguments]
    least = max(float(number.tiny / number.eps), _NOISE**2)
    answer = row.oracle(*exact)
    values, is_sized = _entries(answer), isinstance(answer, Sized)
    largest = max((abs(x) for x in values if mp.isfinite(x)), default=0)
    sizes = answer.sizes if is_sized else [largest] * len(values)
    floor = max(row.floor(*arguments) if callable(row.floor) else row.floor, least)
    sizes = np.array([max(size, floor) for size in sizes])
    gaps = np.array(distances(ours, values))
    relative, absolute = max(gaps / sizes), max(gaps)
    kinds = {"eps": relative / number.eps, "relative": relative}
    judged = kinds.get(row.unit, absolute)
    where, worst = describe(arguments), [(0.0, "")]
    is_kink = row.kink is not None and row.kink(*arguments)
    for i, slopes in zip(wrt, jacobians, strict=True):
        if is_kink:
            is_finite = all(np.isfinite(slope).all() for slope in slopes)
            worst.append((0.0 if is_finite else math.inf, where))
            continue
        unit = row.slope_unit
        unit = unit(arguments, i) if callable(unit) else unit
        truth = _slope(row.oracle, exact, i)
        steepest = np.abs(truth) if is_sized else np.max(np.abs(truth))
        smallest = sizes[:, None] / max(unit, number.tiny) if unit else least
        divisor = np.maximum(steepest, np.maximum(smallest, least))
        for slope in slopes:
            gap = np.reshape(distances(slope, truth.ravel()), truth.shape)
            error = np.max(gap / divisor / number.eps)
            error = _float(error * (error > _NOISE))
            worst.append((error, f"{where}; by argument {i}"))
    errors = [(_float(x), where) for x in (judged, absolute, relative)]
    return [*errors, max(worst)]


_float = lambda error: math.inf if mp.isnan(error) else float(error)
_is_floating = lambda argument: getattr(argument, "dtype", np.dtype(int)).kind == "f"


def exact_numbers(argument: Any) -> Any:
    """Exactly the same numbers in mpmath; what is not floating stays as it is."""
    if not _is_floating(argument):
        return argument
    found = np.empty(argument.size, object)
    found[:] = [mp.mpf(float(x)) for x in np.ravel(argument)]
    return found.reshape(argument.shape)[()]


def distances(ours: Any, exact: Any) -> list:
    """Difference of each entry; infinite where only one of them is a number."""
    gaps = []
    for x, y in zip(np.ravel(ours).tolist(), exact, strict=True):
        is_right = math.isnan(x) if mp.isnan(y) else x == y
        has_gap = not is_right and math.isfinite(x) and mp.isfinite(y)
        gaps.append(abs(x - y) if has_gap else mp.mpf(0) if is_right else mp.inf)
    return gaps


def _entries(answer: Any) -> np.ndarray:
    """Numbers of an exact answer in a row."""
    numbers = answer.values if isinstance(answer, Sized) else answer
    return np.asarray(numbers, object).ravel()


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
            given = *arguments[:index], moved[()], *arguments[index + 1 :]
            sides.append(_entries(oracle(*given)))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.array(columns, object).T


def describe(arguments: Inputs) -> str:
    """Write inputs in one line; small arrays so that they can be typed in again."""
    texts = []
    for x in map(np.asarray, arguments):
        ends = f"{x.shape} numbers, {np.min(x)} to {np.max(x)}"
        texts.append(str(x.tolist()) if x.size <= 100 else ends)
    return " ".join(texts)
