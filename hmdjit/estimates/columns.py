"""The doors of this room: tables of numbers, whose axes are known, and their masks."""

from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

Sessions = Float[np.ndarray, " session"]
Paths = Float[np.ndarray, " path"]
Subjects = Shaped[np.ndarray, " session"]


def numbers(
    name: str, values: Any, axes: tuple[str, ...] | None = ("session",)
) -> Float[np.ndarray, "..."]:
    """Take numbers as floats; what a mask hides is NaN, as a session that failed.

    **Arguments:** `axes`: what each axis is called, first to last; None takes any.

    **Errors:** `ValueError` for other numbers of axes, and for complex numbers.
    """
    found = np.ma.asarray(values)
    if axes is not None and found.ndim != len(axes):
        raise ValueError(
            f"{name} must have {_axes(axes)}, got an array of shape {found.shape}."
        )
    if np.iscomplexobj(found):
        raise ValueError(f"{name} must hold real numbers, got {found.dtype}.")
    return np.ma.filled(found.astype(float), np.nan)


def labels(name: str, values: Any, sessions: int) -> Subjects:
    """Take a label of each session.

    **Errors:** `ValueError` unless every session has one.
    """
    found = np.ma.asarray(values)
    if found.shape != (sessions,):
        raise ValueError(
            f"{name} must have a label for each of {sessions} sessions, got an array "
            f"of shape {found.shape}."
        )
    lacks = (found.data != found.data) | (found.data == None)  # noqa: E711  of each
    missing = int(np.sum(np.ma.getmaskarray(found) | lacks))
    if missing:
        raise ValueError(
            f"{name} must have a label for each session, {missing} have none."
        )
    return found.data


def centred(
    x: Float[np.ndarray, "*rows session"],
) -> tuple[Float[np.ndarray, "*rows"], Float[np.ndarray, "*rows session"]]:
    """Mean of the finite sessions, and how far each is from it: 0 of the others.

    Both are right to rounding however far the spread lies below the mean: equal
    sessions have exactly their mean. Of no session it is 0.
    """
    x = numbers("rows", x, None)
    known = np.isfinite(x)
    count = np.maximum(known.sum(axis=-1, keepdims=True), 1)
    over = lambda values: np.where(known, values, 0.0).sum(-1, keepdims=True) / count
    mean = over(x)
    mean = mean + over(x - mean)  # what a sum of large numbers had lost
    rest = x - mean  # exact where they are close
    return mean[..., 0], np.where(known, rest - over(rest), 0.0)


def _axes(axes: tuple[str, ...]) -> str:
    count = "one axis" if len(axes) == 1 else f"{len(axes)} axes"
    return f"{count} ({', '.join(axes)})"
