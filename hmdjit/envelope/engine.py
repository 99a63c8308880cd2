"""The numerical envelope: how right each public function is, and over which range.

Values are held against the answer in 300 digits (mpmath), and gradients, by reverse and
by forward differentiation, against its central differences.
"""

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .row import Inputs, Row, Sized, mp

DIGITS = 300
_STEP = mp.mpf(10) ** -45  # central differences err by the square, and cancel as much
_LEAST_STEP = 1e-195  # of numbers of size 1 it leaves 100 digits
_NOISE = 1e-100  # what differences of 300 digits are sure to


class Measurement(NamedTuple):
    """The largest errors of a row in one dtype, and the inputs that give them.

    `error` is in `unit`, that of the gradient in eps: NaN where there is none, infinite
    where one is no number.
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

    The quick form has the first dtype only, and of each row the few inputs that it
    states. Inputs depend on seed and name alone. Runs under float64, as a local choice:
    what is float32 stays so.
    """
    for row in rows:
        dtypes = [*row.bounds]
        for dtype in dtypes[: min(row.quick, 1)] if quick else dtypes:
            yield _measured(row, dtype, seed, quick)


def _measured(row: Row, dtype: str, seed: int, quick: bool) -> Measurement:
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
        return [np.ravel(row.function(*given)) for given in inputs], [[]] * len(inputs)
    flat = lambda *arguments: jnp.ravel(row.function(*arguments))
    modes = [jax.jacrev, jax.jacfwd][: 2 - quick] if wrt else []

    @jax.jit
    @jax.vmap
    def all_of(*arguments: Any) -> tuple[Any, ...]:
        jacobians = [mode(flat, wrt)(*arguments) for mode in modes]
        return flat(*arguments), list(zip(*jacobians, strict=True))

    batch = [jnp.asarray(np.stack(column)) for column in zip(*inputs, strict=True)]
    values, slopes = jax.tree.map(np.asarray, all_of(*batch))
    return values, [
        jax.tree.map(lambda x, n=n: x[n], slopes) for n in range(len(inputs))
    ]


def _errors(
    row: Row, number: Any, wrt: tuple, arguments: Inputs, ours: Any, jacobians: list
) -> list[tuple[float, str]]:
    """Judged, absolute and relative error of a value, and error of the gradient."""
    exact = [exact_numbers(x) for x in arguments]
    least = max(float(number.tiny / number.eps), _NOISE**2)
    answer = row.oracle(*exact)
    is_sized, values = isinstance(answer, Sized), _entries(answer)
    largest = max((abs(x) for x in values if mp.isfinite(x)), default=0)
    sizes = answer.sizes if is_sized else [largest] * len(values)
    floor = max(row.floor(*arguments) if callable(row.floor) else row.floor, least)
    sizes = np.array([max(size, floor) for size in sizes])
    gaps = distances(np.reshape(ours, values.shape), values)
    relative, absolute = max(gaps / sizes), max(gaps)
    kinds = {"eps": relative / number.eps, "relative": relative}
    judged = kinds.get(row.unit, absolute)
    where, worst = describe(arguments), [(0.0, "")]
    is_kink, unit = row.kink(*arguments), row.slope_unit
    for i, slopes in zip(wrt, jacobians, strict=True):
        if is_kink:
            is_finite = all(np.isfinite(slope).all() for slope in slopes)
            worst.append((0.0 if is_finite else math.inf, where))
            continue
        truth = _slope(row.oracle, exact, i)
        change = unit(arguments, i) if callable(unit) else unit
        steepest = np.abs(truth) if is_sized else np.max(np.abs(truth))
        smallest = sizes[:, None] / max(change, number.tiny) if change else least
        divisor = np.maximum(steepest, np.maximum(smallest, least))
        for slope in slopes:
            gap = distances(np.reshape(slope, truth.shape), truth)
            error = _float(np.max(gap / divisor / number.eps))
            worst.append((error * (error > _NOISE), f"{where}; by argument {i}"))
    errors = [(_float(x), where) for x in (judged, absolute, relative)]
    return [*errors, max(worst)]


_float = lambda error: math.inf if mp.isnan(error) else float(error)
_numbers_of = lambda answer: answer.values if isinstance(answer, Sized) else answer
_entries = lambda answer: np.asarray(_numbers_of(answer), object).ravel()
_is_floating = lambda argument: getattr(argument, "dtype", np.dtype(int)).kind == "f"


def exact_numbers(argument: Any) -> Any:
    """Exactly the same numbers in mpmath; what is not floating stays as it is."""
    if not _is_floating(argument):
        return argument
    numbers = [mp.mpf(x) for x in np.ravel(argument).tolist()]
    return np.array(numbers, object).reshape(argument.shape)[()]


@np.errstate(invalid="ignore")
@partial(np.vectorize, otypes=[object])
def distances(ours: Any, exact: Any) -> Any:
    """Difference of each entry; infinite where only one of them is a number."""
    is_right = ours == exact or (math.isnan(ours) and mp.isnan(exact))
    gap = mp.zero if is_right else abs(ours - exact)
    return gap if mp.isfinite(gap) else mp.inf


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
    ends = lambda x: f"{x.shape} numbers, {np.min(x)} to {np.max(x)}"
    arrays = map(np.asarray, arguments)
    return " ".join(str(x.tolist()) if x.size <= 100 else ends(x) for x in arrays)
