"""What `simulate` promises of its fast path: derivatives, batches, bits."""

import collections
import functools
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import viewing
from jax.extend.core import ClosedJaxpr, Jaxpr
from jax.flatten_util import ravel_pytree
from small import STILL, path, quickly

import hmdjit as hj
from hmdjit.frames.displacement import GATHER
from hmdjit.techniques import SSAA, Freeze, HeadMovement, NoAntialiasing

# People who sit still move this camera's picture by some 0.2 px per frame.
CAMERA = hj.Camera(width_px=10, height_px=8, fov_deg=0.7, refresh_hz=60.0)
FRAMES = 3
START = (0.3, 1.0)
BATCH = 5


# --- the fast path and gathers ---


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


# --- in all numbers of a technique and of a head ---


def parameters(person="seated"):
    """Kim's numbers and the head's, float64; all as one vector, and back."""
    head = hj.HeadMotion(
        speed_rms_deg_s=(1.12, 0.91, 0.93),
        correlation_time_s=(0.10, 0.124, 0.029),
        tracker_noise_deg=(0.0037, 0.0036, 0.0034),
    )
    if person == "a statue":
        still = ((0.0,) * 3,) * 2
        head = eqx.tree_at(
            lambda h: (h.speed_rms_deg_s, h.tracker_noise_deg), head, still
        )
    kim = HeadMovement(w_min=0.35, w_lb=0.15, h_max_deg_s=12.0, closeness=(0.6,))
    return ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, float), (kim, head)))


@pytest.fixture(scope="module")
def of_parameters():
    """MTCD and detail loss of a session as a function of 15 parameters."""
    texture = viewing.noise_texture(np.random.default_rng(8), CAMERA, 12)
    _, unravel = parameters()

    def measured(vector):
        kim, head = unravel(vector)
        poses = head.sample(jax.random.key(4), 60.0, 6)
        result = hj.simulate(texture, CAMERA, kim, poses, warmup=1)
        return jnp.stack([result.mtcd, result.detail_loss])

    return measured


@pytest.fixture(scope="module")
def pulled(of_parameters):
    """Values, and their derivative weighted by a row, in one program."""

    @quickly
    def pulled(vector, row):
        values, pull = jax.vjp(of_parameters, vector)
        return values, pull(row)[0]

    return pulled


def test_gradients_agree_with_central_differences(pulled):
    start = np.asarray(parameters()[0])
    rows = jnp.eye(2)
    jacobian = [pulled(jnp.asarray(start), row)[1] for row in rows]
    # By relative changes of the parameters, whose sizes differ by 10,000.
    relative = lambda x: pulled(jnp.asarray(x * start), rows[0])[0]
    # Bilinear reads are smooth but where a source crosses a pixel's centre. A relative
    # change of 1e-6 moves sources by 1e-6 px: of some 1,000 reads none crosses. Values
    # round to a few 1e-15 of themselves, differences to as many 1e-9.
    expected = oracles.jacobian(relative, np.ones(len(start)), step=1e-6)
    assert len(start) == 15
    assert (expected != 0).all()  # every parameter moves both
    ours = np.stack(jacobian) * start
    for row, differences, value in zip(ours, expected, relative(1.0), strict=True):
        np.testing.assert_allclose(row, differences, rtol=1e-5, atol=4e-9 * value)


def test_a_statue_sees_no_flicker_and_no_gradient_of_it(pulled):
    start, _ = parameters("a statue")
    (mtcd, loss), of_mtcd = pulled(start, jnp.array([1.0, 0.0]))
    assert mtcd == 0
    assert loss > 0
    np.testing.assert_array_equal(of_mtcd, np.zeros(len(start)))
    _, of_loss = pulled(start, jnp.array([0.0, 1.0]))
    assert jnp.isfinite(of_loss).all()


@pytest.mark.slow
def test_forward_and_reverse_gradients_agree(of_parameters, pulled):
    start, _ = parameters()
    reverse = [pulled(start, row)[1] for row in jnp.eye(2)]
    forward = quickly(jax.jacfwd(of_parameters))(start)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    "technique",
    [
        NoAntialiasing(),
        Freeze(),
        SSAA(2),
        SSAA(4),
        HeadMovement(),
        HeadMovement(resolve=SSAA(2)),
        HeadMovement(
            closeness=(0.3, 0.6, 0.9), difference="max_channel", space="linear"
        ),
        HeadMovement(difference="same_pixel"),
    ],
    ids=lambda technique: technique.id,
)
def test_at_rest_mtcd_and_its_gradient_are_exactly_0(rng, technique):
    texture = viewing.noise_texture(rng, CAMERA, 4)
    numbers = jax.tree.map(lambda x: jnp.asarray(x, float), technique)

    def values(numbers_and_poses):
        numbers, poses = numbers_and_poses
        result = hj.simulate(texture, CAMERA, numbers, poses)
        values = jnp.stack([result.mtcd, result.detail_loss])
        return values, values

    jacobian = quickly(jax.jacrev(values, has_aux=True))
    slopes, (mtcd, _) = jacobian((numbers, jnp.asarray(STILL[:4])))
    assert mtcd == 0
    for of_leaf in jax.tree.leaves(slopes):
        np.testing.assert_array_equal(of_leaf[0], jnp.zeros_like(of_leaf[0]))
        assert jnp.isfinite(of_leaf[1]).all()


@pytest.mark.slow
def test_gradients_reach_the_camera_too(rng):
    texture = viewing.noise_texture(rng, CAMERA, 6)
    poses = jnp.asarray(path(rng, 4, camera=CAMERA))

    def flicker(fov_deg, refresh_hz):
        camera = hj.Camera(CAMERA.width_px, CAMERA.height_px, fov_deg, refresh_hz)
        return hj.simulate(texture, camera, HeadMovement(), poses).mtcd

    slopes = quickly(jax.grad(flicker, (0, 1)))(float(CAMERA.fov_deg), 60.0)
    assert all(jnp.isfinite(slope) and slope != 0 for slope in slopes)
