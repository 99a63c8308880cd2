"""Families of blending curves as spaces without bounds, for a fit to search.

A point of a space is a vector of any real numbers; all of them stand for a technique
within the bounds of Kim et al.'s equations: `0 <= w_lb <= w_min <= 1`, `h_max > 0`,
past samples of rising closeness in `[0, 1]` with weights that do not fall and sum to 1.
Coordinates count no farther than 46 from 0, infinite ones too: there a share is within
1e-20 of its bounds, and numbers without a bound lie between 1e-20 and 1e20.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks
from ..curves import AbstractCurve, Cosine, Kim, Linear, Spline
from ..techniques import HeadMovement

FAMILIES = ("kim", "power", "spline")
LOCALIZATIONS = ("linear", "spline")
MOST_SAMPLES = 4

_EASE_RISES, _LOCAL_RISES = 6, 4  # increments of splines
_NEAREST = 1e-3  # to a bound, where a search starts
_FARTHEST = 46.0  # coordinate; beyond it exp leaves what float32 holds
_FAR = 5.0  # in logarithms: what is farther is not known at all
_LEAST_EXPONENT = 0.5
_LEAST = {"h_max_deg_s": 0.0, "ease.exponent": _LEAST_EXPONENT}

Point = Float[Array, " numbers"]


class CurveSpace(eqx.Module):
    """Head movement with a family of curves.

    - `family`: of the ease curve of head speed: `"kim"`, equation (4) as it is;
      `"power"`, its exponent free; `"spline"`, any curve that does not fall.
    - `samples`: past samples, 1 to 4, each with a closeness and a weight.
    - `localization`: how colour difference counts: `"linear"`, equation (5), or
      `"spline"`, any curve that does not fall.
    """

    family: str = eqx.field(static=True, default="kim")
    samples: int = eqx.field(static=True, default=1)
    localization: str = eqx.field(static=True, default="linear")

    def __check_init__(self):
        _checks.one_of("family", self.family, FAMILIES)
        _checks.whole("samples", self.samples, 1)
        _checks.in_range("samples", self.samples, 1, MOST_SAMPLES)
        _checks.one_of("localization", self.localization, LOCALIZATIONS)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the natural numbers, as `natural` lists them."""
        index = range(self.samples)
        several = self.samples > 1
        return (
            "w_min",
            "w_lb",
            "h_max_deg_s",
            *(f"closeness[{i}]" for i in index),
            *(f"weights[{i}]" for i in index if several),
            *(("ease.exponent",) if self.family == "power" else ()),
            *(f"ease.increments[{i}]" for i in range(self._ease_rises)),
            *(f"localization.increments[{i}]" for i in range(self._local_rises)),
        )

    @property
    def size(self) -> int:
        """Length of a point: increments and weights have one less than there are."""
        spare = [self.samples - 1, max(self._ease_rises - 1, 0)]
        spare += [max(self._local_rises - 1, 0), int(self.family == "power")]
        return 3 + self.samples + sum(spare)

    @property
    def _ease_rises(self) -> int:
        return _EASE_RISES if self.family == "spline" else 0

    @property
    def _local_rises(self) -> int:
        return _LOCAL_RISES if self.localization == "spline" else 0

    def natural(self, point: Point) -> Float[Array, " names"]:
        """Return the numbers that a point stands for, in the order of `names`.

        **Accuracy:** relative to each number, however near 0; gradients are finite,
        and 0 beyond the farthest coordinates.
        """
        left = iter(jnp.clip(point, -_FARTHEST, _FARTHEST))
        take = lambda count: [next(left) for _ in range(count)]
        w_min, below, log_h_max = take(3)
        w_min = jax.nn.sigmoid(w_min)
        numbers = [w_min, w_min * jax.nn.sigmoid(below), jnp.exp(log_h_max)]
        closer, away = jnp.zeros((), point.dtype), jnp.ones((), point.dtype)
        for step in take(self.samples):
            # Each is closer than the one before; `1 - away` would lose small ones.
            closer = jnp.minimum(closer + away * jax.nn.sigmoid(step), 1.0)
            away = away * jax.nn.sigmoid(-step)
            numbers.append(closer)
        if self.samples > 1:
            weights = jnp.cumsum(_simplex(take(self.samples - 1)))
            numbers += list(weights / jnp.sum(weights))
        if self.family == "power":
            numbers.append(_LEAST_EXPONENT + jnp.exp(*take(1)))
        for rises in (self._ease_rises, self._local_rises):
            if rises:
                numbers += list(_simplex(take(rises - 1)))
        return jnp.stack(numbers)

    def technique(self, point: Point) -> HeadMovement:
        """Return what a point stands for; differentiable."""
        return self.of_numbers(self.natural(point))

    def concrete(self, point: Point | Float[np.ndarray, " numbers"]) -> HeadMovement:
        """Return what a point stands for, its numbers Python floats."""
        return jax.tree.map(float, self.technique(jnp.asarray(point)))

    def of_numbers(self, numbers: Float[Array, " names"]) -> HeadMovement:
        """Return the technique of natural numbers, in the order of `names`."""
        left = iter(numbers)
        take = lambda count: tuple(next(left) for _ in range(count))
        w_min, w_lb, h_max = take(3)
        closeness = take(self.samples)
        weights = take(self.samples) if self.samples > 1 else None
        ease: AbstractCurve = Kim()
        if self.family == "power":
            ease = Cosine(*take(1))
        elif self.family == "spline":
            ease = Spline(take(self._ease_rises))
        local: AbstractCurve = Linear()
        if self.localization == "spline":
            local = Spline(take(self._local_rises))
        return HeadMovement(
            w_min, w_lb, h_max, closeness, weights, ease=ease, localization=local
        )

    @property
    def ranges(self) -> tuple[Float[np.ndarray, " names"], Float[np.ndarray, " names"]]:
        """Bounds of the natural numbers."""
        least = np.array([_LEAST.get(name, 0.0) for name in self.names])
        most = np.array([np.inf if name in _LEAST else 1.0 for name in self.names])
        return least, most

    def within(
        self,
        numbers: Float[np.ndarray, " names"],
        steps: Float[np.ndarray, "draws names"],
    ) -> Float[np.ndarray, "draws names"]:
        """Move natural numbers by steps, no farther than their bounds.

        `h_max` and the exponent move by a factor, so that they stay above 0.
        """
        moved = numbers + steps
        for i, name in enumerate(self.names):
            if name in _LEAST:
                factor = np.exp(np.clip(steps[:, i] / numbers[i], -_FAR, _FAR))
                moved[:, i] = np.maximum(numbers[i] * factor, _LEAST[name])
            else:
                moved[:, i] = np.clip(moved[:, i], 0, 1)
        moved[:, 1] = np.minimum(moved[:, 1], moved[:, 0])  # w_lb
        return moved

    def near(self, technique: HeadMovement) -> Point:
        """Point nearest to a technique: bounds are kept a little away from.

        Past samples beyond its own are as close as the last one, curves of another
        family are approached. **Errors:** `ValueError` for more samples than here.
        """
        closeness = sorted(float(d) for d in technique.closeness)
        if len(closeness) > self.samples:
            raise ValueError(
                f"samples must be at least the technique's {len(closeness)}, "
                f"got {self.samples}."
            )
        closeness += [closeness[-1]] * (self.samples - len(closeness))
        w_min, w_lb = float(technique.w_min), float(technique.w_lb)
        point = [_logit(w_min), _logit(w_lb / w_min if w_min else 0.0)]
        point.append(float(np.log(float(technique.h_max_deg_s))))
        left = 1.0
        for d in closeness:
            point.append(_logit(1 - (1 - d) / left if left > 0 else 0.5))
            left *= 1 / (1 + np.exp(point[-1]))
        if self.samples > 1:
            raw = technique.weights or technique.closeness
            weights = sorted(float(w) for w in raw)
            if not any(weights):  # all at d = 0: they count alike
                weights = [1.0] * len(weights)
            weights += [weights[-1]] * (self.samples - len(weights))
            point += _log_ratios(np.diff(weights, prepend=0.0))
        if self.family == "power":
            mine = technique.ease
            exponent = float(mine.exponent) if isinstance(mine, Cosine) else 2.0
            point.append(float(np.log(max(exponent - _LEAST_EXPONENT, _NEAREST))))
        elif self.family == "spline":
            point += _log_ratios(_rises(technique.ease, self._ease_rises))
        if self.localization == "spline":
            point += _log_ratios(_rises(technique.localization, self._local_rises))
        return jnp.asarray(point)

    def starts(self) -> list[Point]:
        """Where a search begins: Kim et al.'s constants, a duller and a livelier one.

        Several past samples begin spread about the one closeness.
        """
        found = []
        for w_min, w_lb, h_max, d in (
            (0.3, 0.1, 25.0, 2 / 3),
            (0.15, 0.05, 12.0, 0.4),
            (0.6, 0.3, 50.0, 0.85),
        ):
            width = 0.4 if self.samples > 1 else 0.0
            spread = 1 - (1 - d) * np.linspace(1 + width, 1 - width, self.samples)
            technique = HeadMovement(w_min, w_lb, h_max, tuple(spread.tolist()))
            found.append(self.near(technique))
        return found


def _simplex(logits: list[Array]) -> Float[Array, " parts"]:
    """Return positive parts that sum to 1; the last one's logit is 0."""
    return jax.nn.softmax(jnp.stack([*logits, jnp.zeros_like(logits[0])]))


def _log_ratios(parts: np.ndarray) -> list[float]:
    """Logits of parts, the last one's being 0."""
    logs = np.log(np.maximum(np.asarray(parts, float) / np.sum(parts), _NEAREST))
    return (logs[:-1] - logs[-1]).tolist()


def _logit(share: float) -> float:
    share = min(max(share, _NEAREST), 1 - _NEAREST)
    return float(np.log(share / (1 - share)))


def _rises(curve: AbstractCurve, count: int) -> np.ndarray:
    if isinstance(curve, Spline) and len(curve.increments) == count:
        return np.asarray(curve.increments, float)
    return np.asarray(Spline.like(curve, count).increments, float)
