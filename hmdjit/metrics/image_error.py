"""Errors of a picture against a reference: MSE, RMSD, PSNR, SNR.

All take values on whatever scale they are given and average over pixels and channels.
PSNR and SNR of identical pictures are infinite: average MSE over frames first.
"""

import jax
import jax.numpy as jnp

from .._types import Numbers, Scalar

PEAK = 255.0


@jax.jit
def mse(test: Numbers, reference: Numbers) -> Scalar:
    """Mean squared error; any one shape."""
    return jnp.mean((test - reference) ** 2)


@jax.jit
def rmsd(test: Numbers, reference: Numbers) -> Scalar:
    """Root of the mean squared error; any one shape."""
    return jnp.sqrt(mse(test, reference))


@jax.jit
def psnr(test: Numbers, reference: Numbers) -> Scalar:
    """Peak signal-to-noise ratio `10 log10(255^2 / MSE)`, dB; inf if equal."""
    return 10 * jnp.log10(PEAK**2 / mse(test, reference))


@jax.jit
def snr(test: Numbers, reference: Numbers) -> Scalar:
    """Signal-to-noise ratio `10 log10(mean(reference^2) / MSE)`, dB; inf if equal."""
    return 10 * jnp.log10(jnp.mean(reference**2) / mse(test, reference))
