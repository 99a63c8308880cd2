"""Hypothesis strategies that build arrays."""

import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

_unit = st.floats(-1.0, 1.0)


def _normalised(components):
    vector = np.array(components)
    return vector / np.linalg.norm(vector)


def _directions(size):
    components = st.tuples(*[_unit] * size)
    return components.filter(lambda c: np.linalg.norm(c) > 0.1).map(_normalised)


orientations = _directions(4).map(jnp.asarray)
"""Unit quaternions `wxyz`, shape `(4,)`."""

vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(lambda v: jnp.array(v))
"""Any vectors, shape `(3,)`."""

fractions = st.floats(0.0, 1.0)


def rotation_vectors(largest_rad=np.pi, smallest_rad=1e-12):
    """Rotation vectors `(3,)` of every scale up to an angle; also exactly 0."""
    exponents = st.floats(np.log10(smallest_rad), np.log10(largest_rad))
    lengths = st.one_of(st.just(0.0), exponents.map(lambda e: 10.0**e))
    return st.builds(lambda n, v: jnp.asarray(n * v), lengths, _directions(3))
