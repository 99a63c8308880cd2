"""A row of the table: a function, its exact answer, and the ranges of its arguments."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from mpmath import mp as _context

mp: Any = _context  # its types know too little
DTYPES = ("float32", "float64")
Rng = np.random.Generator
Inputs = tuple[Any, ...]
Number = float | int


class Bound(NamedTuple):
    """Largest error: of the value, in the row's unit; of the gradient, in eps."""

    value: Number
    gradient: Number = math.nan


def eps(value: Number, gradient: Number = math.nan) -> dict[str, Bound]:
    """Return the same bounds, in eps, for both dtypes."""
    return dict.fromkeys(DTYPES, Bound(value, gradient))


class Argument(NamedTuple):
    """What an argument may be, or several that belong together: in words, and drawn.

    `draw` gives the n-th of them in float64, several in a tuple, from a generator, the
    dtype that it will be rounded to, and n. Extremes come at fixed n.
    """

    over: str
    draw: Callable[[Rng, np.dtype, int], Any]


class Sized(NamedTuple):
    """An exact answer whose entries count by their own sizes, not by the largest."""

    values: Any
    sizes: Any


def own_size(arguments: Inputs, index: int) -> float:
    """Largest entry of an argument, as a `slope_unit`: by this much it may change."""
    return float(np.max(np.abs(arguments[index])))


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
    # Smaller answers count as this large; a number, or of the arguments.
    floor: float | Callable[..., float] = 0.0
    # Gradients below the answer over this count as this large, unless it is 0; a
    # number, or of all arguments and the place of one.
    slope_unit: float | Callable[[Inputs, int], float] = 0.0
    wrt: tuple[int, ...] | None = None  # to differentiate by: None is all floating ones
    kink: Callable[..., Any] = lambda *given: False  # no derivative; ours is finite
    kept: Callable[..., Any] = lambda *given: (
        True
    )  # within ranges that depend on others
    # Called input by input as they are drawn, not compiled and without a gradient.
    eager: bool = False
    count: int = 50  # of inputs
    quick: int = 24  # of those in the quick form

    def __post_init__(self):
        module = getattr(self.function, "__module__", "").removeprefix("hmdjit.")
        name = self.name or f"{module}.{self.function.__name__}"
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
        return [x for x in found if self.kept(*x)]


scaled = partial(Row, slope_unit=own_size)
in_numpy = partial(Row, eager=True, quick=0)
