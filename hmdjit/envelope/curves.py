"""The envelope's cases of curves, and its runs of what sizes by them."""

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import curves, quaternion, sample_patterns
from . import oracles as exact
from .cases import ANGLES, eps
from .measuring import Bound, Case, Inputs, Run, Worst, exact_numbers
from .poses import poses_of, product, unit

_Rng = np.random.Generator
_Found = tuple[float, str]
mp = exact.mp

_SHARES = (0.0, 1.0, 0.5, 2 / 3, 1e-30, 1e-6, 1 - 1e-6, 0.25, 0.75)
_KNOTS = 5


def _shares(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for share in (*_SHARES, *rng.random(20)):
        yield (np.asarray(share, dtype),)


def _powers(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    for n, share in enumerate((*_SHARES, *rng.random(40))):
        exponent = (0.5, 1.0, 2.0, 100.0, 10 ** rng.uniform(-0.3, 2))[n % 5]
        yield np.asarray(share, dtype), np.asarray(exponent, dtype)


def _is_corner(share: np.ndarray, exponent: np.ndarray) -> bool:
    """Whether the curve rises from 0 to both sides."""
    return bool(share == 0 and exponent == 0.5)


def _rises(rng: _Rng, dtype: np.dtype) -> Iterator[Inputs]:
    """Draw shares on and between knots; rises equal, one alone, of all sizes."""
    for n, share in enumerate((*_SHARES, *rng.random(40))):
        one = np.eye(_KNOTS)[n % _KNOTS]
        spread = 10 ** rng.uniform(-12, 12, _KNOTS)
        rises = (np.ones(_KNOTS), one, rng.random(_KNOTS), spread)[n % 4]
        yield np.asarray(share, dtype), np.asarray(rises, dtype)


def _cosine(share: Any, exponent: Any) -> list:
    """Kim et al.'s equation (4) with its exponent free."""
    half = (1 - mp.cos(mp.pi * share[()])) / 2
    return [half ** exponent[()] if half else half]


def _spline(share: Any, rises: Any) -> list:
    """Integral of the polygon of slopes, over all of it."""
    slopes = [2 * rises[0], *rises[1:-1], 2 * rises[-1]]
    last = len(slopes) - 2
    place = share[()] * (last + 1)

    def until(end: Any) -> Any:
        total = mp.mpf(0)
        for i in range(last + 1):
            part = end - i if i == last else min(end - i, mp.mpf(1))
            if i == 0 or part > 0:
                total += part * slopes[i] + part**2 / 2 * (slopes[i + 1] - slopes[i])
        return total

    return [until(place) / until(mp.mpf(last + 1))]


def cases() -> list[Case]:
    """Curves at, next to and between their ends and knots."""
    ends = "share 0, 1e-30 to 1"
    return [
        Case(
            "curves.Kim",
            ends,
            curves.Kim(),
            lambda share: _cosine(share, np.array(mp.mpf(2), object)),
            _shares,
            eps(8, 16),
            floor=1e-30,
            slope_floor=1.0,
        ),
        Case(
            "curves.Cosine",
            f"{ends}, exponent 0.5 to 100",
            lambda share, exponent: curves.Cosine(exponent)(share),
            _cosine,
            _powers,
            # A power takes its base's rounding times the exponent: 200 halves.
            eps(128, 256),
            floor=1e-30,
            slope_floor=1.0,
            has_kink=_is_corner,
        ),
        Case(
            "curves.Spline",
            f"{ends}, rises 0, 1e-12 to 1e12",
            lambda share, rises: curves.Spline(tuple(rises))(share),
            _spline,
            _rises,
            eps(16, 64),
            floor=1e-30,
            slope_floor=1.0,
        ),
    ]


# --- what is not jitted ---


def steepest(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """How far a slope is above the bound that sizes halos, relative; never."""
    del dtype
    worst = Worst()
    share = np.linspace(0, 1, 1001)
    drawn = 3 if quick else 20
    for curve in (
        curves.Linear(),
        curves.Kim(),
        *(curves.Cosine(e) for e in (0.5, 1.0, *10 ** rng.uniform(-0.3, 2, drawn))),
        *(curves.Spline(r) for r in rng.exponential(size=(drawn, _KNOTS)) ** 4),
    ):
        slopes = jax.vmap(jax.grad(curve))(jnp.asarray(share))
        excess = float(jnp.max(slopes)) / curve.steepest - 1
        worst.add(max(excess, 0.0), repr(curve))
    return worst.found


def rebased(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Error of a rebased pose, of poses anywhere, at every angle from the first."""
    del dtype
    worst = Worst()
    for angle in (*ANGLES, *10 ** rng.uniform(-9, 0, 5 if quick else 50)):
        first = unit(rng.normal(size=4))
        turn = poses_of(angle * unit(rng.normal(size=3)))
        poses = np.stack([first, rng.choice([-1, 1]) * product(first, turn)])
        answer = exact.relative(*exact_numbers(poses))
        if answer[0] < 0:
            answer = [-x for x in answer]
        ours = quaternion.rebase(poses)[1]
        is_half_turn = abs(answer[0]) < 1e-9  # either sign is right
        gap = lambda sign, a=answer, o=ours: max(
            abs(x - sign * mp.mpf(y)) for x, y in zip(a, o.tolist(), strict=True)
        )
        error = min(gap(1), gap(-1)) if is_half_turn else gap(1)
        worst.add(float(error), f"{angle!r} rad, poses {poses.tolist()}")
    return worst.found


def radical_inverses(rng: _Rng, dtype: str, quick: bool) -> _Found:
    """Error of mirrored digits against exact fractions."""
    del dtype, quick
    worst = Worst()
    for base in (2, 3, 5):
        for index in (0, 1, 2, 15, *rng.integers(0, 10**9, 20).tolist()):
            mirrored, rest, place = Fraction(0), index, Fraction(1, base)
            while rest:
                rest, digit = divmod(rest, base)
                mirrored, place = mirrored + digit * place, place / base
            ours = Fraction(sample_patterns.radical_inverse(base, index))
            worst.add(float(abs(ours - mirrored)), f"base {base}, index {index}")
    return worst.found


def runs() -> list[Run]:
    """List what is float64, in NumPy: not in the quick form, which is of float32."""
    return [
        Run(
            "curves, steepest",
            "all curves, 1001 shares",
            steepest,
            {"float64": Bound(1e-12)},
            "relative",
            is_slow=True,
        ),
        Run(
            "quaternion.rebase",
            "0, denormals, 1e-30 to pi rad, any first pose",
            rebased,
            {"float64": Bound(4 * math.ulp(1.0))},
            "absolute",
            is_slow=True,
        ),
        Run(
            "sample_patterns.radical_inverse",
            "bases 2, 3, 5, indices to 1e9",
            radical_inverses,
            {"float64": Bound(4 * math.ulp(1.0))},
            "absolute",
            is_slow=True,
        ),
    ]
