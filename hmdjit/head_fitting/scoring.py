"""Influence of each window on a fitted head: Fisher scoring at the estimate."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float64, Int

from . import whittle
from .spectra import Periodograms
from .whittle import Data, Search

_FLAT = 1e-10  # of the largest information: what has less is not determined


class Scoring(NamedTuple):
    """Fisher scoring at the estimate: numbers are the values, then the scales.

    - `score`: of each window.
    - `information`: of a window of each subject.
    - `subject`: of each window.
    """

    score: Float64[np.ndarray, "windows numbers"]
    information: Float64[np.ndarray, "subjects numbers numbers"]
    subject: Int[np.ndarray, " windows"]

    @classmethod
    def of(cls, periodograms: Periodograms, search: Search, data: Data) -> "Scoring":
        """Take scores and informations at the end of a search."""
        expected, gradient = (np.asarray(x, float) for x in _sensitivity(search, data))
        expected = expected.reshape(len(expected), -1)
        gradient = gradient.reshape(*expected.shape, -1)
        subject = periodograms.subject
        power = periodograms.power.reshape(len(subject), -1)
        excess = power / expected[subject] - 1
        score = [e @ gradient[i] for e, i in zip(excess, subject, strict=True)]
        information = np.stack([g.T @ g for g in gradient])
        return cls(np.stack(score), information, subject)

    def without(self, held: Bool[np.ndarray, " held"]) -> "Scoring":
        """Hold some of the first numbers where they are: they count for nothing."""
        free = np.ones(self.score.shape[1])
        free[: len(held)] = ~held
        kept = self.information * free * free[:, None]
        return self._replace(score=self.score * free, information=kept)

    def identifiable(self, values: int) -> Bool[np.ndarray, " values"]:
        """Which of the first numbers lie in no flat direction of the likelihood."""
        whole = self.information[self.subject].sum(axis=0)
        sizes, vectors = np.linalg.eigh(whole)
        flat = vectors[:values, sizes <= _FLAT * sizes[-1]]
        return np.sum(flat**2, axis=1) < 0.5

    def jackknife(
        self, cluster: Int[np.ndarray, " windows"]
    ) -> Float64[np.ndarray, "clusters numbers"]:
        """Influence of each cluster: one Fisher step of the estimate without it."""
        of_window = self.information[self.subject]
        whole = of_window.sum(axis=0)
        moves = []
        for i in range(cluster.max() + 1):
            rest = whole - of_window[cluster == i].sum(axis=0)
            moves.append(_inverse(rest) @ self.score[cluster == i].sum(axis=0))
        return np.stack(moves)

    def noise(self, values: int) -> Float64[np.ndarray, " subjects"]:
        """Variance of each subject's scale between its windows."""
        inverse = _inverse(self.information[self.subject].sum(axis=0))
        step = self.score @ inverse[:, values:]
        squared = step[np.arange(len(step)), self.subject] ** 2
        return np.bincount(self.subject, weights=squared)


def _inverse(information: np.ndarray) -> np.ndarray:
    # The mean of the scales, and that of who was left out, are not determined.
    return np.linalg.pinv(information, rcond=_FLAT, hermitian=True)


@eqx.filter_jit
def _sensitivity(search: Search, data: Data) -> tuple[Array, Array]:
    """Return expected powers, and their logarithm's gradient by value and scale."""

    def log_expected(values: Array, log_scale: Array) -> Array:
        scale = whittle.centred(Search(values, log_scale), data)
        return whittle.log_expected(values, scale, data)

    at = (whittle.log_values(search, data), search.log_scale)
    gradients = jax.jacfwd(log_expected, (0, 1))(*at)
    shape = (*data.power.shape, -1)
    flat = [gradient.reshape(shape) for gradient in gradients]
    return jnp.exp(log_expected(*at)), jnp.concatenate(flat, axis=-1)
