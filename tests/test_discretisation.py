import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from hmdjit.head_motion.discretisation import discretise


def float32_of(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)


def double_integrator(spring):
    """In units of the correlation time: x' = v - spring x, v' = -v + white."""
    drift = np.array([[-spring, 1.0], [0.0, -1.0]])
    return drift, np.array([[0.0, 0.0], [0.0, 2.0]])


def exact_double_integrator(spring, dt):
    """Closed form, with 80 digits to spare for its cancellations."""
    with mpmath.workdps(80):
        b, dt = mpmath.mpf(spring), mpmath.mpf(dt)
        fast, slow = mpmath.exp(-dt), mpmath.exp(-b * dt)
        transition = mpmath.matrix([[slow, (slow - fast) / (1 - b)], [0, fast]])
        both = 1 / (1 + b)
        stationary = mpmath.matrix([[both / b, both], [both, 1]])
        noise = stationary - transition * stationary * transition.T
        change = transition - mpmath.eye(2)
        return [np.array(m.tolist(), float) for m in (change, noise)]


def mode(damping):
    """In units of its frequency: x' = v, v' = -x - 2 damping v + white."""
    drift = np.array([[0.0, 1.0], [-1.0, -2 * damping]])
    return drift, np.array([[0.0, 0.0], [0.0, 4 * damping]])


def exact_mode(drift, dt):
    """By a matrix exponential of 80 digits; the stationary covariance is 1."""
    with mpmath.workdps(80):
        transition = mpmath.expm(mpmath.matrix(drift.tolist()) * mpmath.mpf(dt))
        change = transition - mpmath.eye(2)
        noise = mpmath.eye(2) - transition * transition.T
        return [np.array(m.tolist(), float) for m in (change, noise)]


def head_and_neck():
    """Slow velocity and two resonators integrated to an angle, entries near 1."""
    drift = scipy.linalg.block_diag(
        -0.5, [[0, 2.0], [-2.0, -0.9]], [[0, 3.0], [-3.0, -0.4]], -0.01
    )
    drift[5, 0:5:2] = 1.0
    return drift, np.diag([1.0, 0.0, 2.0, 0.0, 0.5, 0.0])


def van_loan(drift, diffusion, dt):
    size = len(drift)
    block = np.block([[-drift, diffusion], [np.zeros_like(drift), drift.T]])
    exponential = scipy.linalg.expm(block * dt)
    transition = exponential[size:, size:].T
    return transition - np.eye(size), transition @ exponential[:size, size:]


@pytest.mark.parametrize("spring", [1e-8, 1e-3, 0.5, 100.0])
@pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-14), (np.float32, 3e-6)])
def test_discretisation_is_exact_from_tiny_to_huge_steps(spring, dtype, rtol):
    drift, diffusion = (jnp.asarray(m, dtype) for m in double_integrator(spring))
    for dt in 10.0 ** np.arange(-9, 6.5, 0.5):
        change, noise = discretise(drift, diffusion, jnp.asarray(dt, dtype))
        exact_change, exact_noise = exact_double_integrator(
            float(drift[0, 0]) * -1, float(jnp.asarray(dt, dtype))
        )
        np.testing.assert_allclose(noise, exact_noise, rtol=rtol)
        # What has been forgotten need not keep relative precision.
        atol = 0.0 if dt <= 1 else rtol
        np.testing.assert_allclose(change, exact_change, rtol=rtol, atol=atol)


@pytest.mark.parametrize("damping", [1e-3, 0.02, 0.3, 1.0, 2.0])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_discretisation_of_a_mode_is_exact_from_tiny_to_huge_steps(damping, dtype):
    drift, diffusion = (jnp.asarray(m, dtype) for m in mode(damping))
    # A mode rings for 1 / damping radians, for so long rounding adds up.
    rtol = (20 + 1 / damping) * float(np.finfo(dtype).eps)
    for exponent in np.arange(-6, 6.5, 0.5):
        dt = dtype(10.0**exponent)
        found = discretise(drift, diffusion, jnp.asarray(dt))
        exact = exact_mode(np.asarray(drift, float), float(dt))
        for ours, oracle in zip(found, exact, strict=True):
            np.testing.assert_allclose(ours, oracle, atol=rtol * np.abs(oracle).max())
        # On short steps the noise of the angle is (4 damping / 3) dt^3, far below that
        # of the velocity: its own digits are kept.
        if dt < 0.1:
            np.testing.assert_allclose(found[1], exact[1], rtol=rtol)


@pytest.mark.parametrize("dt", [1e-9, 1e-4, 0.01, 0.3, 2.0, 5.0])
def test_discretisation_agrees_with_van_loan(dt):
    drift, diffusion = head_and_neck()
    oracle_change, oracle_noise = van_loan(drift, diffusion, dt)
    change, noise = discretise(jnp.asarray(drift), jnp.asarray(diffusion), dt)
    scale = np.max(np.abs(oracle_noise))
    # The oracle itself subtracts the identity.
    np.testing.assert_allclose(change, oracle_change, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(noise, oracle_noise, rtol=1e-10, atol=1e-13 * scale)


@pytest.mark.parametrize("dt", [1e-9, 1e-4, 0.01, 0.3, 2.0, 50.0, 1e4])
def test_discretisation_in_float32_agrees_with_float64(dt):
    exact = [jnp.asarray(m) for m in (*head_and_neck(), dt)]
    rounded = float32_of(exact)
    exact = [jnp.asarray(m, jnp.float64) for m in rounded]
    for ours, oracle in zip(discretise(*rounded), discretise(*exact), strict=True):
        scale = np.max(np.abs(oracle))
        np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-6 * scale)


@given(st.floats(-6, 3), st.floats(-6, 3))
@settings(max_examples=20)
def test_two_steps_are_one_long_step(exponent, other_exponent):
    drift, diffusion = map(jnp.asarray, head_and_neck())
    first, second = 10.0**exponent, 10.0**other_exponent
    change, noise = discretise(drift, diffusion, first)
    later_change, later_noise = discretise(drift, diffusion, second)
    both_change, both_noise = discretise(drift, diffusion, first + second)
    later = jnp.eye(6) + later_change
    np.testing.assert_allclose(
        both_change, change + later_change + later_change @ change, atol=1e-12
    )
    carried = later @ noise @ later.T
    scale = float(jnp.max(jnp.abs(both_noise)))
    np.testing.assert_allclose(
        both_noise, carried + later_noise, rtol=1e-11, atol=1e-12 * scale
    )


@pytest.mark.parametrize("system", [double_integrator(0.1), mode(1e-3), mode(2.0)])
def test_gradients_of_the_discretisation_are_correct(system):
    # Only symmetric diffusions are allowed: no steps to others.
    sampled = lambda drift, d, dt: discretise(drift, (d + d.T) / 2, dt)
    for dt in (1e-3, 0.05, 0.7, 4.0):
        arguments = tuple(jnp.asarray(m) for m in (*system, dt))
        # Central differences with steps of 6e-6 err by about 1e-10.
        check_grads(sampled, arguments, 1, modes=("fwd", "rev"), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_of_the_discretisation_are_finite(dtype):
    jacobians = jax.jit(jax.jacrev(discretise, argnums=(0, 1, 2)))
    for system in (double_integrator(0.1), mode(1e-3), mode(1.0), mode(2.0)):
        drift, diffusion = (jnp.asarray(m, dtype) for m in system)
        for dt in (0.0, 1e-9, 1e6):
            found = jacobians(drift, diffusion, jnp.asarray(dt, dtype))
            assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_steps_of_1e12_correlation_times_are_taken(dtype):
    # 30 doublings went to 2^26; a longer step came out as if it had been short.
    drift = jnp.asarray([[-1e-6, 1e6], [0.0, -1e6]], dtype)
    diffusion = jnp.asarray([[0.0, 0.0], [0.0, 2e6]], dtype)
    rtol = 1e3 * float(jnp.finfo(dtype).eps)
    for dt in (1e3, 1e6, 1e20):
        change, noise = discretise(drift, diffusion, jnp.asarray(dt, dtype))
        np.testing.assert_allclose(change[0, 0], np.expm1(-1e-6 * dt), rtol=rtol)
        np.testing.assert_allclose(change[1, 1], -1.0, rtol=rtol)
        np.testing.assert_allclose(noise[1, 1], 1.0, rtol=rtol)
        # But for the 1e-6 s of the fast mode, over the step and over the slow mode.
        law = 1e12 * -np.expm1(-2e-6 * dt)
        np.testing.assert_allclose(noise[0, 0], law, rtol=rtol + 2e-6 / dt + 2e-12)
