"""The numerical envelope: how right each function is, and in which range.

A *case* is a function, the exact answer in 300 digits, and inputs that cover its range
on a logarithmic scale with the extremes among them. Values are held against the answer,
and gradients, by reverse and by forward differentiation, against its central
differences. A *run* is what has no closed answer: a session, a long recursion, a
picture with a hole. It measures one error by itself. Both become rows with a stated
bound.
"""

import dataclasses
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
from mpmath import mp

from .. import _files

DIGITS = 300
DTYPES = ("float32", "float64")

# Central differences in the oracle err by its square, and cancel so many digits.
_STEP = mpmath.mpf(10) ** -45
Inputs = tuple[np.ndarray, ...]
Exact = Sequence[Any]
"""Numbers of mpmath: the entries of an answer, flattened."""


class Bound(NamedTuple):
    """Largest error: of the value, in the case's unit; of the gradient, in eps."""

    value: float | int
    gradient: float | int | None = None


@dataclasses.dataclass(frozen=True)
class Case:
    """A function to hold against its exact answer.

    - `name`, `over`: the function, and its range in words.
    - `function`: of JAX arrays, unbatched.
    - `oracle`: of the same arguments as arrays of mpmath numbers; entries flattened.
    - `inputs`: from a random generator and a dtype, arguments one after the other.
    - `bounds`: by dtype; those it lacks are not measured.
    - `unit`: `"eps"`: the error is relative to the answer's largest entry, in units of
      the dtype's eps. Else errors are absolute, in that unit.
    - `floor`: answers below this count as this large.
    - `slope_floor`: the same for gradients, as share of answer over argument, or over
      `slope_unit` where the answer does not scale with the argument. Without a unit
      gradients at an argument of 0 have no floor.
    - `unit_at_0`: from all arguments, that unit of one that is 0, where the true slope
      is 0 as well.
    - `wrt`: arguments to differentiate by; None is all that are floating.
    - `has_kink`: tells where the answer has no derivative (ours must be finite).
    - `is_slow`: whether it is left out of the quick form.
    """

    name: str
    over: str
    function: Callable[..., Any]
    oracle: Callable[..., Exact]
    inputs: Callable[[np.random.Generator, np.dtype], Iterator[Inputs]]
    bounds: dict[str, Bound]
    unit: str = "eps"
    floor: float = 0.0
    slope_floor: float = 0.0
    slope_unit: float | None = None
    unit_at_0: Callable[..., float] | None = None
    wrt: tuple[int, ...] | None = None
    has_kink: Callable[..., bool] | None = None
    is_slow: bool = False


@dataclasses.dataclass(frozen=True)
class Run:
    """Something whose error is measured as a whole.

    - `measure`: from a random generator, a dtype's name and whether to be quick, the
      largest error, and where it occurs.
    """

    name: str
    over: str
    measure: Callable[[np.random.Generator, str, bool], tuple[float, str]]
    bounds: dict[str, Bound]
    unit: str
    is_slow: bool = False


class Row(NamedTuple):
    """What was found of a case or a run in one dtype.

    - `error`, `bound`: largest error in `unit`, and what it may be.
    - `absolute`, `relative`: largest absolute error, and relative to the answer.
    - `gradient`, `gradient_bound`: the same of the gradient, in eps; NaN where there is
      none, infinite where one is not a number.
    - `worst`, `worst_gradient`: the inputs that give them.
    - `inputs`: how many were tried.
    - `seed`: of the inputs.
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
    seed: int = 0

    @property
    def holds(self) -> bool:
        """Whether both bounds hold."""
        has_gradient = not math.isnan(self.gradient_bound)
        value_holds = self.error <= self.bound
        return value_holds and not (
            has_gradient and self.gradient > self.gradient_bound
        )


def measure(
    entries: Sequence[Case | Run],
    *,
    seed: int = 0,
    quick: bool = False,
    progress: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Measure every entry in every dtype that it has a bound for.

    The quick form has float32 only, fewer inputs, shorter runs and no slow entry.
    Runs under float64, as a local choice: what is float32 stays so.
    """
    rows = []
    with jax.enable_x64(True), mp.workdps(DIGITS):
        for entry in entries:
            if quick and entry.is_slow:
                continue
            for dtype, bound in entry.bounds.items():
                if quick and dtype != DTYPES[0]:
                    continue
                # Each row's inputs depend on the seed and its name alone.
                name = zlib.crc32(f"{entry.name} {entry.over}".encode())
                rng = np.random.default_rng([seed, name])
                if isinstance(entry, Run):
                    row = _of_run(entry, rng, dtype, bound, quick)
                else:
                    row = _of_case(entry, rng, dtype, bound, quick)
                row = row._replace(seed=seed)
                rows.append(row)
                progress(row)
    return rows


def _of_run(
    run: Run, rng: np.random.Generator, dtype: str, bound: Bound, quick: bool
) -> Row:
    error, where = run.measure(rng, dtype, quick)
    absent, nan = "", math.nan
    absolute, relative = (nan, error) if run.unit == "relative" else (error, nan)
    numbers = (error, float(bound.value), absolute, relative, nan, nan)
    return Row(run.name, run.over, dtype, run.unit, *numbers, where, absent, 1)


_QUICK_INPUTS = 24


def _of_case(
    case: Case, rng: np.random.Generator, dtype: str, bound: Bound, quick: bool
) -> Row:
    number = np.dtype(dtype)
    found = list(case.inputs(rng, number))
    if quick and len(found) > _QUICK_INPUTS:
        # Evenly, but not every second one: kinds of inputs alternate.
        kept = np.linspace(0, len(found) - 1, _QUICK_INPUTS).astype(int)
        found = [found[n] for n in kept]
    wrt = case.wrt
    if wrt is None:
        wrt = tuple(
            i for i, x in enumerate(found[0]) if np.issubdtype(x.dtype, np.floating)
        )
    if bound.gradient is None:
        wrt = ()
    values, *jacobians = _evaluated(case.function, found, wrt, quick)
    eps = float(np.finfo(number).eps)
    tiny = float(np.finfo(number).tiny)
    worst = Worst(), Worst(), Worst(), Worst()
    for n, arguments in enumerate(found):
        where = describe(arguments)
        exact_arguments = [exact_numbers(x) for x in arguments]
        answer = list(case.oracle(*exact_arguments))
        ours = np.ravel(values[n])
        has_kink = case.has_kink is not None and case.has_kink(*arguments)
        size = max((abs(x) for x in answer if mp.isfinite(x)), default=mp.mpf(0))
        scale = max(size, mp.mpf(case.floor), mp.mpf(tiny) / eps)
        absolute = distance(ours, answer)
        relative = float(absolute / scale) if absolute else 0.0
        absolute = float(absolute)
        judged = relative / eps if case.unit == "eps" else absolute
        for worst_one, error in zip(worst, (judged, absolute, relative), strict=False):
            worst_one.add(error, where)
        for k, i in enumerate(wrt):
            slopes = [np.reshape(j[k][n], (len(ours), -1)) for j in jacobians]
            if has_kink:
                is_finite = all(np.isfinite(slope).all() for slope in slopes)
                worst[3].add(0.0 if is_finite else math.inf, where)
                continue
            exact = _slope(case.oracle, exact_arguments, i, len(answer))
            largest = max(abs(x) for x in exact)
            # At 0 an argument has no size: there the slope itself is all there is.
            unit = case.slope_unit or float(np.max(np.abs(arguments[i])))
            if not unit and case.unit_at_0 is not None:
                unit = case.unit_at_0(*arguments)
            floor = case.slope_floor * float(scale) / max(unit, tiny) if unit else 0.0
            divisor = max(largest, mp.mpf(floor), mp.mpf(tiny) / eps)
            for slope in slopes:
                error = distance(np.ravel(slope), exact) / divisor
                worst[3].add(float(error) / eps, f"{where}; by argument {i}")
    return Row(
        case.name,
        case.over,
        dtype,
        case.unit,
        worst[0].error,
        float(bound.value),
        worst[1].error,
        worst[2].error,
        worst[3].error if wrt else math.nan,
        math.nan if bound.gradient is None else float(bound.gradient),
        worst[0].where,
        worst[3].where,
        len(found),
    )


class Worst:
    """The largest error so far, and where it occurs."""

    def __init__(self):
        self.error, self.where = 0.0, "nowhere"

    @property
    def found(self) -> tuple[float, str]:
        """Both, as a run returns them."""
        return self.error, self.where

    def add(self, error: float, where: str) -> None:
        """Take in another error; one that is no number is infinite."""
        error = math.inf if math.isnan(error) else float(error)
        if error > self.error or self.where == "nowhere":
            # In one line, as a row is: models are written in several.
            self.error, self.where = error, " ".join(where.split())


def _evaluated(
    function: Callable, found: list[Inputs], wrt: tuple[int, ...], quick: bool
) -> tuple[Any, ...]:
    """Values, reverse and (unless quick) forward Jacobians of all inputs."""
    batch = [jnp.asarray(np.stack(column)) for column in zip(*found, strict=True)]
    flat = lambda *arguments: jnp.ravel(function(*arguments))

    @jax.jit
    @jax.vmap
    def all_of(*arguments: Any) -> tuple[Any, ...]:
        value = flat(*arguments)
        if not wrt:
            return (value,)
        by = [jax.jacrev] if quick else [jax.jacrev, jax.jacfwd]
        return value, *(jacobian(flat, wrt)(*arguments) for jacobian in by)

    return jax.tree.map(lambda x: np.asarray(x, np.float64), all_of(*batch))


def exact_numbers(argument: np.ndarray) -> np.ndarray:
    """Exactly the same numbers in mpmath; whole numbers stay as they are."""
    if not np.issubdtype(argument.dtype, np.floating):
        return argument
    numbers = [mp.mpf(float(x)) for x in np.ravel(argument)]
    return np.array([*numbers, None], object)[:-1].reshape(argument.shape)


def distance(ours: np.ndarray, exact: Exact) -> Any:
    """Largest difference; infinite where ours is not finite and the answer is."""
    worst = mp.mpf(0)
    for x, y in zip(ours.tolist(), exact, strict=True):
        if mp.isnan(y):
            error = mp.mpf(0) if math.isnan(x) else mp.inf
        else:
            error = abs(mp.mpf(x) - y) if math.isfinite(x) else mp.inf
        worst = max(worst, error)
    return worst


def _slope(
    oracle: Callable[..., Exact], arguments: list[np.ndarray], index: int, rows: int
) -> list[Any]:
    """Jacobian by one argument, `(rows, entries)` flattened, by central differences."""
    argument = arguments[index]
    every = [x for each in arguments for x in np.ravel(each) if isinstance(x, mp.mpf)]
    smallest = min((abs(x) for x in every if x), default=mp.mpf(1))
    columns = []
    for place in np.ndindex(argument.shape):
        step = _STEP * (abs(argument[place]) or smallest)
        sides = []
        for sign in (1, -1):
            moved = argument.copy()
            moved[place] = moved[place] + sign * step
            changed = [*arguments[:index], moved, *arguments[index + 1 :]]
            sides.append(oracle(*changed))
        ahead, behind = sides
        columns.append(
            [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
        )
    return [column[row] for row in range(rows) for column in columns]


def describe(arguments: Inputs) -> str:
    """Write inputs so that they can be typed in again."""
    texts = []
    for x in arguments:
        numbers = ", ".join(map(repr, np.ravel(x).tolist()))
        texts.append(numbers if x.ndim == 0 else f"[{numbers}]")
    return " ".join(texts)


def write_csv(rows: Sequence[Row], path: Path) -> Path:
    """Write all rows, whole or not at all."""
    return _files.write_csv(
        path, [{**row._asdict(), "holds": row.holds} for row in rows]
    )
