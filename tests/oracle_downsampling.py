"""Downsampling as it is described: a large picture, and loops over its texels."""

import math
from typing import Any

import numpy as np


def decode(gamma):
    curve = ((np.maximum(gamma, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(gamma <= 0.04045, gamma / 12.92, curve)


def encode(linear):
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def large_picture(samples):
    """Texels in their places, `(3, factor height, factor width)`, of samples."""
    factor = math.isqrt(len(samples))
    _, channels, height, width = samples.shape
    large = np.zeros((channels, factor * height, factor * width))
    for k, planes in enumerate(samples):
        large[:, k // factor :: factor, k % factor :: factor] = planes
    return large


def lanczos(x):
    if x == 0:
        return 1.0
    if abs(x) >= 2:
        return 0.0
    return 2 * math.sin(math.pi * x) * math.sin(math.pi * x / 2) / (math.pi * x) ** 2


def reads(line, pixel, factor, taps):
    """Yield what is read around a pixel of a line of texels, and how far away."""
    last = len(line) - 1
    centre = factor * pixel + (factor - 1) / 2
    if taps == "exact":
        for texel in range(factor * (pixel - 3), factor * (pixel + 4)):
            yield (texel - centre) / factor, line[min(max(texel, 0), last)]
    else:
        for k in range(-5, 6):
            at = centre + factor * 4 * k / 11
            left = math.floor(at)
            one, other = (line[min(max(t, 0), last)] for t in (left, left + 1))
            yield 4 * k / 11, one + (at - left) * (other - one)


def filtered(line, factor, taps):
    """Downsample along the first axis."""
    result = []
    for pixel in range(len(line) // factor):
        total, weights = 0.0, 0.0
        for x, value in reads(line, pixel, factor, taps):
            total, weights = total + lanczos(x) * value, weights + lanczos(x)
        result.append(total / weights)
    return np.stack(result)


def ssaa(samples, factor, space, filter_, taps: Any = "exact"):
    """Gamma picture `(3, height, width)` of gamma samples, row by row."""
    large = large_picture(np.asarray(samples, float))
    large = decode(large) if space == "linear" else large
    if filter_ == "box":
        channels, rows, columns = large.shape
        result = np.zeros((channels, rows // factor, columns // factor))
        for y in range(rows // factor):
            for x in range(columns // factor):
                block = large[:, factor * y :, factor * x :][:, :factor, :factor]
                result[:, y, x] = block.mean(axis=(1, 2))
    else:
        across = filtered(np.moveaxis(large, 2, 0), factor, taps)  # x, channel, y
        result = np.moveaxis(
            filtered(np.moveaxis(across, 2, 0), factor, taps), (0, 1), (1, 2)
        )
        result = np.clip(result, 0, 1)
    return encode(result) if space == "linear" else result
