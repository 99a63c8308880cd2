"""Quaternions in NumPy: the inputs of the envelope, in float64."""

import numpy as np

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1 along the last axis; those of length 0 stay."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length == 0, 1.0, length)


def poses_of(turns: np.ndarray) -> np.ndarray:
    """Quaternions `(..., 4)` of rotation vectors `(..., 3)`, rad."""
    half = np.linalg.norm(turns, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), np.sinc(half / np.pi) * turns / 2], -1)


def product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions `(..., 4)`, which broadcast."""
    p, q = left[..., 1:], right[..., 1:]
    v, w = left[..., :1], right[..., :1]
    real = v * w - np.sum(p * q, axis=-1, keepdims=True)
    return np.concatenate([real, v * q + w * p + np.cross(p, q)], axis=-1)
