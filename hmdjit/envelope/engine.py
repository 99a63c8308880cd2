"""A row of the table: a function, its exact answer, its arguments; and how right it is.

Values are held against the answer in 300 digits (mpmath), and gradients, by reverse and
by forward differentiation, against its central differences.
"""

import dataclasses
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from mpmath import mp as _context

mp: Any = _context  # its types know too little
DTYPES: tuple[str, ...] = ("float32", "float64")
Rng = np.random.Generator
Inputs = tuple[Any, ...]
Number = float | int
DIGITS = 300
_STEP = mp.mpf(10) ** -45  # central differences err by the square, and cancel as much
_LEAST_STEP = 1e-195  # of numbers of size 1 it leaves 100 digits
_NOISE = 1e-100  # what differences of 300 digits are sure to


class Bound(NamedTuple):
    """Largest error: of the value, in the row's unit; of the gradient, in eps."""

    value: Number
    gradient: Number = math.nan


def eps(value: Number, gradient: Number = math.nan) -> dict[str, Bound]:
    """Give both dtypes the same bounds."""
    return dict.fromkeys(DTYPES, Bound(value, gradient))


class Argument(NamedTuple):
    """What an argument may be, or several that belong together, then in a tuple.

    The n-th is drawn in float64, for a dtype that it will be rounded to; some n give
    extremes.
    """

    over: str  # in words
    draw: Callable[[Rng, np.dtype, int], Any]


class Sized(NamedTuple):
    """An exact answer whose entries count by their own sizes, not by the largest."""

    values: Any
    sizes: Any


@dataclasses.dataclass(frozen=True)
class Row:
    """A function to hold against its exact answer.

    An error in the unit `"eps"` is relative to the answer's largest entry, in units of
    the dtype's eps; in `"relative"` without it; else it is absolute, in that unit.
    """

    function: Callable[..., Any]  # of JAX arrays, unbatched
    oracle: Callable[..., Any]  # of the same in mpmath numbers; an array, or `Sized`
    arguments: Sequence[Argument]
    bounds: dict[str, Bound]  # by dtype; those it lacks are not measured
    unit: str = "eps"
    name: str = ""  # by default the function's path in the package
    floor: float | Callable[..., float] = 0.0  # smaller answers count as this large
    # Gradients count as at least the answer over this, unless it is 0.
    slope_unit: float | Callable[[Inputs, int], float] = 0.0
    wrt: tuple[int, ...] | None = None  # to differentiate by: None is all floating ones
    kink: Callable[..., Any] | None = None  # no derivative; ours is finite
    kept: Callable[..., Any] | None = None  # within ranges that depend on others
    eager: bool = False  # called input by input as drawn, without a gradient
    count: int = 50  # of inputs
    quick: int = 24  # of those in the quick form

    def __post_init__(self):
        module = getattr(self.function, "__module__", "").removeprefix("hmdjit.")
        name = self.name or f"{module}.{self.function.__qualname__}"
        object.__setattr__(self, "name", name)

    @property
    def over(self) -> str:
        """The ranges of all arguments in words."""
        return "; ".join(dict.fromkeys(a.over for a in self.arguments if a.over))

    def inputs(self, rng: Rng, dtype: np.dtype) -> list[Inputs]:
        """Draw all inputs, rounded to a dtype."""
        columns = []
        for argument in self.arguments:
            drawn = [argument.draw(rng, dtype, k) for k in range(self.count)]
            # Else extremes would only meet those of other arguments at the same n.
            order = rng.permutation(self.count) if columns else range(self.count)
            columns.append([drawn[k] for k in order])
        found = []
        for parts in zip(*columns, strict=True):
            each = [x for p in parts for x in (p if type(p) is tuple else (p,))]
            if not self.eager:
                arrays = [np.asarray(x) for x in each]
                each = [x if x.dtype.kind == "i" else x.astype(dtype) for x in arrays]
            found.append(tuple(each))
        return [x for x in found if self.kept is None or self.kept(*x)]


def own_size(arguments: Inputs, index: int) -> float:
    """Size of an argument's largest entry, by which it may change."""
    return float(np.max(np.abs(arguments[index])))


scaled = partial(Row, slope_unit=own_size)
in_numpy = partial(Row, eager=True, quick=0)


class Measurement(NamedTuple):
    """The largest errors of a row in one dtype, infinite where one is no number."""

    name: str
    over: str
    dtype: str
    unit: str
    error: float  # in the unit
    bound: float
    absolute: float
    relative: float
    gradient: float  # in eps; NaN where none is asked for
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

    The quick form has the first dtype only, and the few inputs that a row states, which
    depend on seed and name alone. Under float64 what is float32 stays so.
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
    numbers = error, float(bound), absolute, relative
    slopes = gradient if wrt else math.nan, float(steepest)
    named = row.name, row.over, dtype, row.unit
    return Measurement(*named, *numbers, *slopes, where, place, len(inputs), seed)


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
    at = lambda n: jax.tree.map(lambda slope: slope[n], slopes)
    return values, [at(n) for n in range(len(inputs))]


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
    where, worst = " ".join(map(_typed, arguments)), [(0.0, "")]
    is_kink, unit = row.kink and row.kink(*arguments), row.slope_unit
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


_ends = lambda x: f"{x.shape} numbers, {np.min(x)} to {np.max(x)}"
# Small arrays so that they can be typed in again.
_typed = lambda x: str(np.asarray(x).tolist()) if np.size(x) <= 100 else _ends(x)
_float = lambda error: math.inf if mp.isnan(error) else float(error)
_entries = lambda answer: np.asarray(getattr(answer, "values", answer), object).ravel()
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
