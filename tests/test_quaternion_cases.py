"""Cases that the tests of four rotation libraries try, written for our functions.

- Eigen, geo_quaternion. Here: slerp's angle, axis-angle around all axes, scaled axes
  (tiny, near half a turn, w = ±0), lengths off 1, q v q*. In test_quaternion.py:
  inverse, composition, both signs. Not ours: matrices as input, two vectors, maps.
- SciPy, Rotation, Slerp, RotationSpline. Here: matrices, series near 0, powers, apply
  in batches, keyframes and beyond, what is refused, no rotation at all. There: all
  functions agree with SciPy, rotation vectors. Not ours: Euler, Davenport and MRP
  angles, mean, alignment, groups, order of times (each fraction stands alone).
- numpy-quaternion. Here: products and logs of units, lengths, NaN and inf, distances,
  slerp's equivariance and speed, many steps. There: exp(log q), log(exp r), tiny
  vectors. Not ours: exp of what is no rotation, spherical and Euler angles, squad.
- jaxlie. Here: derivatives both ways, left and right Jacobian, also at half a turn,
  adjoint. There: group axioms, bijection, plus and minus (increments), jit, vmap. Not
  ours: SO(2), SE(2), SE(3), matrices as input, serialization.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import jacobian
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from hmdjit import camera as pinhole
from hmdjit import quaternion
from hmdjit.envelope import exact_geometry as exact
from hmdjit.envelope.engine import mp
from hmdjit.frames import motion as motions

ROUNDING = 1e-14  # a few dozen roundings of numbers of size 1 in float64
ONE, *_ = UNITS = np.eye(4)  # 1, i, j, k
AXES = np.array([*np.eye(3), *-np.eye(3), np.array([1, 2, 3]) / 14**0.5])
SKEW = np.array([0.48, -0.6, 0.64])
_signs = np.array(list(itertools.product([0.0, -1.0, 1.0], repeat=4))[1:])
# Both signs of 40 rotations: no turn, third, quarter and half turns among them.
ROTORS = _signs / np.linalg.norm(_signs, axis=1, keepdims=True)

close = functools.partial(np.testing.assert_allclose, rtol=0, atol=ROUNDING)
equal = np.testing.assert_array_equal
scipy_rotation = functools.partial(Rotation.from_quat, scalar_first=True)
random_poses = lambda rng, count: Rotation.random(count, rng).as_quat(scalar_first=True)
every_dtype = pytest.mark.parametrize("dtype", [np.float32, np.float64])


def rows(function):
    """Apply it to each row of its arguments; one compilation serves all numbers."""
    # Optimising a program takes longer than running it.
    quickly = {"xla_backend_optimization_level": "0"}
    batch = jax.jit(jax.vmap(function), compiler_options=quickly)

    def call(*arguments):
        count = max(len(a) for a in arguments)
        padded = (np.resize(a, (256, *np.shape(a)[1:])) for a in arguments)
        return np.asarray(batch(*padded))[:count]

    return call


exp, log, angle = rows(quaternion.exp), rows(quaternion.log), rows(quaternion.angle)
matrix = rows(quaternion.matrix_minus_identity)
multiply, rotate = rows(quaternion.multiply), rows(quaternion.rotate)
relative, slerp = rows(quaternion.relative), rows(quaternion.slerp)
slerp_slope = rows(jax.jacfwd(quaternion.slerp, argnums=2))
CAMERA = pinhole.Camera(width_px=64, height_px=48)
homography = rows(functools.partial(pinhole.homography, CAMERA))
checked_motion = jax.jit(lambda poses: motions.checked_motion(poses, poses.dtype))


def turned(angle_rad):
    return np.array([np.cos(angle_rad / 2), *(np.sin(angle_rad / 2) * SKEW)])


def assert_same_rotation(ours, theirs, atol=ROUNDING):
    close((scipy_rotation(ours).inv() * theirs).magnitude(), 0, atol=atol)


# --- Eigen: geo_quaternion ---

PAIRS = {
    "any": (ROTORS[3], np.array([0.1, -0.7, 0.5, 0.5])),
    "half a turn apart": (turned(0.7), turned(0.7 + np.pi)),
    "equal": (turned(0.7), turned(0.7)),
    "q and -q": (ROTORS[7], -ROTORS[7]),
    "orthogonal": (ONE, UNITS[2]),
    "nearly opposite": (turned(0.7), turned(0.7 + 2 * np.pi - 1e-9)),
    "nearly half a turn apart": (turned(0.7), turned(0.7 + np.pi - 1e-9)),
    "nearly equal": (turned(0.7), turned(0.7 + 1e-9)),
}


@pytest.mark.parametrize(("start", "end"), PAIRS.values(), ids=PAIRS)
def test_slerps_angle_grows_linearly_up_to_the_whole_angle(start, end):
    fractions, first = np.linspace(0, 1, 11), scipy_rotation(start).inv()
    between = slerp(start[None], end[None], fractions)
    whole = (first * scipy_rotation(end)).magnitude()
    close((first * scipy_rotation(between)).magnitude(), fractions * whole, atol=1e-15)
    close(np.linalg.norm(between, axis=1), 1)


def test_axis_and_angle_around_every_axis_of_both_signs_and_beyond_a_turn():
    turns = np.pi * np.array([*np.arange(-4, 4.1, 0.25), 1 - 1e-3, 1 - 1e-6, 1 - 1e-9])
    angles, axes = np.repeat(turns, len(AXES))[:, None], np.tile(AXES, (36, 1))
    q = exp(angles * axes)
    close(q, np.hstack([np.cos(angles / 2), np.sin(angles / 2) * axes]))
    # The shorter way round; at half a turn, within rounding, either.
    rest = np.remainder(angles + np.pi, 2 * np.pi) - np.pi
    found, is_half = log(q), np.abs(rest) > np.pi - 1e-12
    is_other = is_half & (np.sum(found * rest * axes, axis=1, keepdims=True) < 0)
    close(found, np.where(is_other, -rest, rest) * axes)
    assert (np.linalg.norm(found, axis=1) <= np.pi + 1e-15).all()


def test_lengths_off_1_cancel_in_logs_and_length_0_has_no_log(rng):
    q, start = rng.normal(size=(20, 4)), random_poses(rng, 1)
    scaled, theirs = q * np.logspace(-5, 5, 20)[:, None], scipy_rotation(q)
    close(log(scaled), theirs.as_rotvec())
    apart = (scipy_rotation(start).inv() * theirs).as_rotvec()
    close(log(relative(start, scaled)), apart, atol=1e5 * ROUNDING)  # 1e5 - 1
    assert np.isnan(log(np.zeros((1, 4)))).all()


def test_rotating_is_the_sandwich_product_the_matrix_and_the_adjoint(rng):
    vectors = rng.normal(size=(len(ROTORS), 3))
    expected = scipy_rotation(ROTORS).apply(vectors)
    close(rotate(ROTORS, vectors), expected)
    sandwich = multiply(ROTORS, np.insert(vectors, 0, 0, axis=1))
    close(multiply(sandwich, ROTORS * [1, -1, -1, -1])[:, 1:], expected)
    moved = np.einsum("nij,nj->ni", matrix(log(ROTORS)), vectors)
    close(vectors + moved, expected)
    close(multiply(exp(expected), ROTORS), multiply(ROTORS, exp(vectors)))


# --- SciPy: Rotation, Slerp, RotationSpline ---


def test_matrices_are_orthogonal_with_determinant_1_at_every_angle():
    lengths = [0, 1e-12, 1e-4, 1, np.pi, 2 * np.pi, 10, 100]
    rotations = np.kron(np.c_[lengths], AXES)
    found, atol = matrix(rotations) + np.eye(3), 10 * ROUNDING  # of 100 rad
    close(found @ found.swapaxes(1, 2) - np.eye(3), 0, atol=atol)
    close(np.linalg.det(found), 1, atol=atol)
    close(found, Rotation.from_rotvec(rotations).as_matrix(), atol=atol)
    to_ray = np.array([[1, 0, -32], [0, -1, 24], [0, 0, -CAMERA.focal_px]])
    expected = -np.linalg.inv(to_ray) @ found @ to_ray
    close(homography(rotations), expected, atol=64 * atol)


@every_dtype
def test_series_and_closed_forms_meet_and_tiny_rotations_last(dtype):
    eps, tiny = float(np.finfo(dtype).eps), float(np.finfo(dtype).tiny)
    # At |r|^2 or |r|^2 / 4 = sqrt(eps); the logarithm's at tan^2(|r| / 2). The first
    # five rotations are those whose square is about the smallest number.
    edges = [tiny**0.5, eps**0.25, 2 * eps**0.25, 2 * np.arctan(eps**0.25)]
    lengths = np.outer(edges, 1 + 4 * eps * np.arange(-2, 3)).ravel()
    rotations = np.outer(lengths, SKEW).astype(dtype)
    for ours, theirs, inputs in [
        (exp, exact.exp, rotations),
        (log, exact.log, exp(rotations)),
        (matrix, exact.rotation_change, rotations[5:]),
    ]:
        with mp.workdps(50):
            values = [np.array([mp.mpf(float(x)) for x in row]) for row in inputs]
            answers = [[float(y) for y in theirs(row).ravel()] for row in values]
        found = ours(inputs).reshape(len(answers), -1)
        np.testing.assert_allclose(found, answers, rtol=6 * eps)


def test_powers_are_multiples_of_the_logarithm(rng):
    base = np.concatenate([random_poses(rng, 6), turned(1e-12)[None]])
    for power in (-5, -2, -1.5, -1, -0.5, -0.0, 0, 0.5, 1, 1.5, 2, 5):
        assert_same_rotation(exp(power * log(base)), scipy_rotation(base) ** power)


def test_apply_pairs_every_rotation_with_every_vector(rng):
    q, vectors = random_poses(rng, 6), rng.normal(size=(5, 3))
    each = jax.jit(jax.vmap(jax.vmap(quaternion.rotate, (None, 0)), (0, None)))
    theirs = scipy_rotation(np.repeat(q, 5, axis=0)).apply(np.tile(vectors, (6, 1)))
    close(each(q, vectors), theirs.reshape(6, 5, 3))
    assert jax.eval_shape(each, q[:0], vectors).shape == (0, 5, 3)


def test_slerp_between_keyframes_and_beyond_them_at_the_same_speed(rng):
    keys = random_poses(rng, 5) * np.array([[1], [-1], [1], [1], [-1]])
    times = np.array([0, 0.5, 0.25, 4, 1, 1.5, 2, 2.75, 3, 3.25, 3.6])
    k = np.minimum(times.astype(int), 3)
    ours = slerp(keys[k], keys[k + 1], times - k)
    assert_same_rotation(ours, Slerp(np.arange(5), scipy_rotation(keys))(times))
    # SciPy's Slerp refuses these times; its spline of two rotations takes them.
    beyond = np.array([-5, -1, -0.1, 1.2, 3, 20])
    line = RotationSpline([0, 1], scipy_rotation(keys[:2]))(beyond)  # up to 60 rad
    assert_same_rotation(slerp(keys[:1], keys[1:2], beyond), line, 20 * ROUNDING)


@pytest.mark.parametrize("row", [0 * ONE, [np.inf, 0, 0, 0], [0.8, np.nan, 0.6, 0]])
def test_poses_that_are_no_rotations_are_refused_or_not_a_number(row):
    poses = np.array([ONE, row, ONE, ONE])
    message = r"^poses\[1\] must have a length in \[0.99, 1.01\], got (0|inf|nan).$"
    with pytest.raises(ValueError, match=message):
        motions.checked_motion(poses, np.float64)
    motion = checked_motion(poses)
    equal(np.isnan(motion.offset), np.outer([0, 1, 0, 0], [1, 1, 1]))
    equal(np.isnan(motion.increment), np.outer([0, 1, 1, 0], [1, 1, 1]))


# --- numpy-quaternion ---


def test_products_and_logs_of_units():
    one, i, j, k = UNITS
    table = multiply(np.repeat(UNITS, 4, axis=0), np.tile(UNITS, (4, 1)))
    equal(table, [one, i, j, k, i, -one, k, -j, j, -k, -one, i, k, j, -i, -one])
    # Either zero is half a turn: about the axis as it is given.
    for w in (0.0, -0.0):
        close(log(np.insert(AXES, 0, w, axis=1)), np.pi * AXES, atol=1e-15)
    # Theirs of -1 is half a turn about x, ours of either sign of a rotation the same.
    logs = np.pi * np.array([one, i, j, k, one, -i, -j, -k])[:, 1:]
    equal(log(np.array([*UNITS, *-UNITS])), logs)


def test_distance_is_a_metric_that_turning_both_leaves_alone(rng):
    q = np.concatenate([ROTORS[:10], -ROTORS[:1], random_poses(rng, 5)])
    a, b, other = np.repeat(q, 16, axis=0), np.tile(q, (16, 1)), q[-1:]
    between = lambda a, b: angle(log(relative(a, b))).reshape(16, 16)
    distance = between(a, b)
    assert (relative(a, b)[:, 0] >= 0).all()
    equal([*np.diag(distance), distance[0, 10]], 0)  # from itself and its negative
    close(distance, distance.T)
    assert (distance[:, None] <= distance[:, :, None] + distance + ROUNDING).all()
    close(between(multiply(other, a), multiply(other, b)), distance)
    close(between(multiply(a, other), multiply(b, other)), distance)


def test_slerp_turns_with_its_keyframes_evenly_and_stays_between_equal_ones(rng):
    start, rate, fractions = ROTORS, rng.normal(size=(80, 3)), np.linspace(-2, 3, 80)
    end = multiply(start, exp(rate))
    here = slerp(start, end, fractions)
    close(here, multiply(start, slerp(ONE[None], exp(rate), fractions)))
    spin = np.insert(log(exp(rate)) / 2, 0, 0, axis=1)
    close(slerp_slope(start, end, fractions), multiply(here, spin))
    for same in (start, -start):
        equal(slerp(start, same, fractions), start)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_one_component_that_is_no_number_leaves_none(bad):
    q, r, one = np.array([[0.5, -0.5, 0.5, 0.5]]), SKEW[None], np.ones(1)
    bad_q, bad_r = np.where(np.eye(4), bad, q), np.where(np.eye(3), bad, r)
    results = [exp(bad_r), angle(bad_r), matrix(bad_r), rotate(bad_q, r)]
    results += [multiply(bad_q, q), multiply(q, bad_q), log(relative(q, bad_q))]
    results += [slerp(bad_q, q, one), slerp(q, bad_q, one), slerp(q, q, bad * one)]
    assert [np.isfinite(result).any() for result in results] == [False] * 10


@every_dtype
def test_lengths_multiply_and_a_thousand_steps_round_come_back(dtype):
    step, start = turned(2 * np.pi / 1000).astype(dtype), ONE.astype(dtype)
    compose = lambda _, q: quaternion.multiply(q, step)
    last = jax.jit(lambda q: jax.lax.fori_loop(0, 1000, compose, q))(start)
    close(last, -ONE, atol=1000 * np.finfo(dtype).eps)  # with the other sign
    # Nothing is normalised.
    close(np.linalg.norm(multiply(1.1 * ROTORS, 0.8 * ROTORS), axis=1), 0.88)


# --- jaxlie ---


def test_derivatives_both_ways_agree_with_differences():
    def products(rotation):
        q, other = quaternion.exp(rotation), jnp.asarray(turned(0.9)[::-1])
        undone = quaternion.multiply(q, quaternion.conjugate(other))
        twice = quaternion.log(quaternion.multiply(q, q))
        apart, moved = quaternion.relative(other, q), quaternion.rotate(q, other[:3])
        return jnp.concatenate([undone, twice, apart, moved])

    points = np.outer([0, 1e-6, 1e-4, 1, 2.5, 4, 7], SKEW)
    forward, ours = rows(jax.jacfwd(products))(points), rows(products)
    close(rows(jax.jacrev(products))(points), forward)
    differences = [jacobian(lambda r: ours(r[None])[0], point) for point in points]
    close(forward, np.array(differences), atol=1e-8)


def test_left_and_right_jacobians_of_the_logarithm():
    def both(rotation):
        q, move, zero = quaternion.exp(rotation), quaternion.exp, 0 * rotation
        left = lambda r: quaternion.log(quaternion.multiply(move(r), q))
        right = lambda r: quaternion.log(quaternion.multiply(q, move(r)))
        return jnp.stack([jax.jacfwd(side)(zero) for side in (left, right)])

    lengths = np.array([0, 1e-7, 1e-4, 1, 3.1, np.pi - 1e-6])
    rotations = np.outer(lengths, SKEW)
    cross = np.cross(rotations[:, None], np.eye(3)).swapaxes(1, 2)
    a = np.maximum(lengths, 1e-2)  # there the share is 1/12, off by 1e-7 of 1e-8
    share = (1 / a**2 - 1 / (2 * a * np.tan(a / 2)))[:, None, None]
    even = np.eye(3) + share * cross @ cross
    close(rows(both)(rotations), np.stack([even - cross / 2, even + cross / 2], axis=1))
    # float32's pi lies beyond half a turn: there the other way round is shorter.
    assert np.isfinite(rows(both)((np.pi * AXES).astype(np.float32))).all()
