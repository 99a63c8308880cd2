"""What `simulate` promises of its fast path: derivatives, batches, bits."""

import collections
import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import viewing
from jax.extend.core import ClosedJaxpr, Jaxpr

import hmdjit as hj
from hmdjit.frames.displacement import GATHER
from hmdjit.techniques import HeadMovement

CAMERA = hj.Camera(width_px=8, height_px=6, fov_deg=0.6, refresh_hz=60.0)
FRAMES = 3
START = (0.3, 1.0)
BATCH = 5

# Optimising a program takes longer than all the rest of a test.
quickly = functools.partial(
    jax.jit, compiler_options={"xla_backend_optimization_level": "0"}
)


@pytest.fixture(scope="module")
def measured():
    """MTCD and detail loss as a function of `w_min` and of how fast the head turns."""
    rng = np.random.default_rng(2)
    texture = viewing.noise_texture(rng, CAMERA, 6)
    turns = jnp.asarray(0.4 * rng.normal(size=(FRAMES, 3)) / float(CAMERA.focal_px))

    def measured(vector, reading=None):
        w_min, speed = vector
        turn = jnp.cumsum(speed * turns, axis=0)
        # Small enough for the half angle; `simulate` takes nearly unit quaternions.
        poses = jnp.concatenate([jnp.sqrt(1 - (turn**2).sum(1))[:, None], turn], axis=1)
        kim = HeadMovement(w_min=w_min)
        result = hj.simulate(texture, CAMERA, kim, poses, reading=reading)
        return jnp.stack([result.mtcd, result.detail_loss])

    return measured


@pytest.fixture
def both(measured):
    """The fast path that `simulate` chooses here, and gathers."""
    if jax.default_backend() != "cpu":
        pytest.skip("only a CPU reads by slices")
    return measured, functools.partial(measured, reading=GATHER)


BATCHED = jnp.asarray(np.array(START) + np.linspace(0, 0.2, BATCH)[:, None])
DIRECTION = jnp.array([0.3, -1.0])


def mtcd(measured):
    return lambda vector: measured(vector)[0]


def total(measured):
    return lambda vectors: jax.vmap(mtcd(measured))(vectors).sum()


TRANSFORMED = {
    "jvp": lambda f: lambda x: jax.jvp(f, (x[0],), (DIRECTION,)),
    "grad": lambda f: lambda x: jax.grad(mtcd(f))(x[0]),
    "value_and_grad": lambda f: lambda x: jax.value_and_grad(mtcd(f))(x[0]),
    "vmap": lambda f: lambda x: jax.vmap(f)(x),
    "vmap(grad)": lambda f: lambda x: jax.vmap(jax.grad(mtcd(f)))(x),
    "grad(vmap)": lambda f: lambda x: jax.grad(total(f))(x),
    "jacfwd": lambda f: lambda x: jax.jacfwd(f)(x[0]),
    "jacrev": lambda f: lambda x: jax.jacrev(f)(x[0]),
    "hessian": lambda f: lambda x: jax.hessian(mtcd(f))(x[0]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRANSFORMED)
def test_what_jax_makes_of_the_fast_path_is_what_it_makes_of_gathers(both, name):
    ours, expected = (quickly(TRANSFORMED[name](f))(BATCHED) for f in both)
    assert max(jnp.abs(leaf).max() for leaf in jax.tree.leaves(expected)) > 1e-3
    # Values round to a few ulps of sums over some 50 pixels; derivatives are the same
    # program.
    close = functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-11)
    jax.tree.map(close, ours, expected)


@pytest.fixture(scope="module")
def value(measured):
    return quickly(measured)


@pytest.mark.slow
def test_derivatives_through_a_batch_are_those_of_the_fast_path_itself(both, value):
    fast, _ = both
    total = lambda vectors: jax.vmap(fast)(vectors).sum()
    gradients = quickly(jax.grad(total))(BATCHED)
    # A step of 1e-6 moves reads by less than 1e-6 px: none crosses a texel's centre.
    # Values round to 1e-14 of some 1,000, differences to 1e-7.
    for vector, gradient in zip(np.asarray(BATCHED), gradients, strict=True):
        at = lambda x: value(jnp.asarray(x)).sum()
        expected = oracles.jacobian(at, vector, step=1e-6)
        assert (np.abs(expected) > 0.01).all()
        np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_second_derivatives_are_those_of_the_first(both):
    fast, _ = both
    gradient = quickly(jax.grad(mtcd(fast)))
    hessian = quickly(jax.hessian(mtcd(fast)))(jnp.asarray(START))
    expected = oracles.jacobian(lambda x: gradient(jnp.asarray(x)), START, step=1e-6)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9)
    np.testing.assert_allclose(hessian, expected, rtol=1e-5, atol=1e-5)


def equations(jaxpr):
    """Of a program and of all that is within it."""
    for equation in jaxpr.eqns:
        yield equation
        for parameter in jax.tree.leaves(
            list(equation.params.values()),
            is_leaf=lambda leaf: isinstance(leaf, ClosedJaxpr | Jaxpr),
        ):
            if isinstance(parameter, ClosedJaxpr):
                yield from equations(parameter.jaxpr)
            elif isinstance(parameter, Jaxpr):
                yield from equations(parameter)


def picture_reads(program, argument):
    """How often a program slices and gathers texels, by how many axes they have."""
    found = collections.Counter()
    for equation in equations(jax.make_jaxpr(program)(argument).jaxpr):
        if equation.primitive.name in ("dynamic_slice", "gather"):
            axes = equation.invars[0].aval.ndim
            found[equation.primitive.name, axes] += axes > 3
    return found


def test_a_batch_of_sessions_reads_one_after_the_other(both):
    fast, _ = both
    one = picture_reads(fast, BATCHED[0])
    assert one["dynamic_slice", 5] > 0
    # Nothing has a further axis, no slice has become a gather.
    assert picture_reads(jax.vmap(fast), BATCHED) == one
    assert picture_reads(jax.vmap(jax.vmap(fast)), BATCHED[None]) == one


@pytest.mark.slow
def test_a_batch_takes_no_longer_than_its_sessions():
    camera = hj.Camera(width_px=64, height_px=64, fov_deg=7.0)
    rng = np.random.default_rng(6)
    texture = viewing.noise_texture(rng, camera, 12, dtype=jnp.float32)
    paths = np.stack([viewing.path(rng, camera, 40) for _ in range(8)])
    paths = jnp.asarray(paths, jnp.float32)

    def one(poses):
        return hj.simulate(texture, camera, HeadMovement(), poses).mtcd

    def seconds(program):
        compiled = jax.jit(program).lower(paths).compile()
        times = []
        for _ in range(7):
            start = time.perf_counter()
            compiled(paths).block_until_ready()
            times.append(time.perf_counter() - start)
        return min(times)

    batch, loop = seconds(jax.vmap(one)), seconds(lambda p: jax.lax.map(one, p))
    assert batch < 2 * loop


@pytest.mark.slow
def test_in_a_batch_a_session_has_the_same_bits(both, value):
    batch = quickly(jax.vmap(both[0]))(BATCHED)
    np.testing.assert_array_equal(batch, [value(vector) for vector in BATCHED])


@pytest.mark.slow
def test_compiled_again_a_session_has_the_same_bits(both):
    again = jax.jit(lambda x: both[0](x)), jax.jit(lambda x: both[0](x))
    first, second = (program(BATCHED[0]) for program in again)
    np.testing.assert_array_equal(first, second)
