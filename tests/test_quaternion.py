import jax
import jax.numpy as jnp
import jaxlie
import mpmath
import numpy as np
import pytest
from hypothesis import given
from oracles import jacobian, rotation_matrix
from scipy.spatial.transform import Rotation, Slerp
from strategies import fractions, orientations, rotation_vectors, vectors

from hmdjit import quaternion

# A few dozen roundings of numbers of size 1 in float64.
ROUNDING = 1e-14
EPS32 = float(np.finfo(np.float32).eps)
IDENTITY = jnp.array([1.0, 0.0, 0.0, 0.0])


def scipy_rotation(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def walk(rng, frames, step_rad):
    """Float64 poses far from the identity that turn by `step_rad` in each frame."""
    axes = rng.normal(size=(frames - 1, 3))
    steps = step_rad * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    poses = [Rotation.from_rotvec([0.3, -1.9, 0.7])]
    for step in steps:
        poses.append(poses[-1] * Rotation.from_rotvec(step))
    quaternions = np.stack([pose.as_quat(scalar_first=True) for pose in poses])
    return quaternions, steps


# --- laws ---


@given(orientations, orientations, orientations)
def test_multiplication_is_associative(a, b, c):
    left = quaternion.multiply(quaternion.multiply(a, b), c)
    right = quaternion.multiply(a, quaternion.multiply(b, c))
    np.testing.assert_allclose(left, right, rtol=0, atol=ROUNDING)


@given(orientations)
def test_conjugate_is_the_inverse(q):
    product = quaternion.multiply(q, quaternion.conjugate(q))
    np.testing.assert_allclose(product, IDENTITY, rtol=0, atol=ROUNDING)


@given(orientations, vectors)
def test_rotation_keeps_length(q, vector):
    turned = quaternion.rotate(q, vector)
    lengths = jnp.linalg.norm(turned), jnp.linalg.norm(vector)
    np.testing.assert_allclose(*lengths, rtol=0, atol=20 * ROUNDING)  # vectors of 17


@given(orientations, orientations, vectors)
def test_multiplication_composes_rotations(a, b, vector):
    both = quaternion.rotate(quaternion.multiply(a, b), vector)
    one_by_one = quaternion.rotate(a, quaternion.rotate(b, vector))
    np.testing.assert_allclose(both, one_by_one, rtol=0, atol=20 * ROUNDING)


@given(rotation_vectors(largest_rad=3.14))
def test_log_inverts_exp(rotation):
    back = quaternion.log(quaternion.exp(rotation))
    # Relative to the whole vector: a component is as exact as the longest one.
    error = np.linalg.norm(back - rotation)
    assert error <= ROUNDING * np.linalg.norm(rotation)


@given(orientations)
def test_exp_inverts_log_up_to_sign(q):
    back = quaternion.exp(quaternion.log(q))
    np.testing.assert_allclose(abs(back @ q), 1.0, rtol=0, atol=ROUNDING)


@given(orientations)
def test_log_is_the_same_for_both_signs_and_at_most_half_a_turn(q):
    rotation = quaternion.log(q)
    if q[0] != 0:  # at exactly half a turn either axis is right
        np.testing.assert_array_equal(rotation, quaternion.log(-q))
    assert jnp.linalg.norm(rotation) <= np.pi + ROUNDING


@given(orientations, orientations, fractions)
def test_slerp_keeps_unit_length(start, end, fraction):
    length = jnp.linalg.norm(quaternion.slerp(start, end, fraction))
    np.testing.assert_allclose(length, 1.0, rtol=0, atol=ROUNDING)


@given(orientations, orientations)
def test_slerp_starts_at_the_start_and_ends_at_the_end(start, end):
    first = quaternion.slerp(start, end, 0.0)
    last = quaternion.slerp(start, end, 1.0)
    np.testing.assert_allclose(first, start, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(abs(last @ end), 1.0, rtol=0, atol=ROUNDING)


@given(rotation_vectors())
def test_angle_is_the_length_at_every_scale(rotation):
    expected = np.linalg.norm(np.asarray(rotation) * 1e20) / 1e20
    np.testing.assert_allclose(quaternion.angle(rotation), expected, rtol=1e-15)


def test_increments_chain_back_to_the_poses(rng):
    poses, _ = walk(rng, 10, 0.3)
    poses = jnp.asarray(poses)
    q = poses[0]
    for increment, pose in zip(quaternion.increments(poses), poses, strict=True):
        q = quaternion.multiply(q, quaternion.exp(increment))
        np.testing.assert_allclose(abs(q @ pose), 1.0, rtol=0, atol=ROUNDING)


def test_a_session_of_one_frame_has_not_moved():
    poses = jnp.array([[0.5, 0.5, -0.5, 0.5]])
    np.testing.assert_array_equal(quaternion.increments(poses), np.zeros((1, 3)))
    np.testing.assert_array_equal(quaternion.offsets(poses), np.zeros((1, 3)))


# --- independent oracles ---


def every_function(a, b, vector, rotation, fraction):
    return {
        "multiply": quaternion.multiply(a, b),
        "conjugate": quaternion.conjugate(a),
        "rotate": quaternion.rotate(a, vector),
        "log": quaternion.log(a),
        "exp": quaternion.exp(rotation),
        "matrix": quaternion.matrix_minus_identity(rotation),
        "angle": quaternion.angle(rotation),
        "slerp": quaternion.slerp(a, b, fraction),
    }


def test_functions_agree_with_scipy_however_they_are_called(variant, rng):
    a, b = Rotation.random(2, rng)
    vector = np.array([0.3, -1.0, 2.0])
    quaternions = (r.as_quat(scalar_first=True) for r in (a, b))
    arguments = (*quaternions, vector, a.as_rotvec(), 0.25)
    ours = variant(every_function)(*(jnp.asarray(value) for value in arguments))
    between = Slerp([0.0, 1.0], Rotation.concatenate([a, b]))(0.25)
    for name, orientation in [
        ("multiply", a * b),
        ("conjugate", a.inv()),
        ("exp", a),
        ("slerp", between),
    ]:
        turn = (scipy_rotation(ours[name]).inv() * orientation).as_rotvec()
        np.testing.assert_allclose(turn, 0, atol=ROUNDING, err_msg=name)
    for name, expected in [
        ("rotate", a.apply(vector)),
        ("log", a.as_rotvec()),
        ("matrix", a.as_matrix() - np.eye(3)),
        ("angle", a.magnitude()),
    ]:
        np.testing.assert_allclose(ours[name], expected, atol=ROUNDING, err_msg=name)


@given(orientations, orientations, fractions)
def test_slerp_agrees_with_scipy(start, end, fraction):
    ours = scipy_rotation(quaternion.slerp(start, end, fraction))
    keyframes = scipy_rotation(np.stack([start, end]))
    oracle = Slerp([0.0, 1.0], keyframes)(fraction)
    half_turn = np.isclose((keyframes[0].inv() * keyframes[1]).magnitude(), np.pi)
    # At half a turn both arcs are equally short, so either answer is right.
    assert half_turn or (ours.inv() * oracle).magnitude() < 1e-7  # scipy's own acos


@given(rotation_vectors(largest_rad=3.14), orientations)
def test_exp_and_log_agree_with_jaxlie(rotation, q):
    group = jaxlie.SO3.exp(rotation)
    # jaxlie switches to a Taylor series early: right to 1e-9 there.
    np.testing.assert_allclose(quaternion.exp(rotation), group.wxyz, atol=1e-9)
    ours, theirs = quaternion.log(q), jaxlie.SO3(q).log()
    if abs(q[0]) > 1e-6:  # else half a turn: either axis is right
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("length", [1e-30, 1e-15, 1e-8, 1e-4, 2e-4, 1e-2, 1.0, 3.1])
def test_exp_log_and_matrix_agree_with_50_digits(length):
    rotation = length * np.array([0.48, -0.6, 0.64])
    q = quaternion.exp(jnp.asarray(rotation))
    back = quaternion.log(q)
    entries = quaternion.matrix_minus_identity(jnp.asarray(rotation))
    with mpmath.workdps(50):
        r = mpmath.matrix([mpmath.mpf(float(c)) for c in rotation])
        angle = mpmath.norm(r)
        exact = [mpmath.cos(angle / 2), *(mpmath.sin(angle / 2) * r / angle)]
        exact = [float(c) for c in exact]
        x, y, z = r
        cross = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        sine = mpmath.sin(angle) / angle
        versine = 2 * (mpmath.sin(angle / 2) / angle) ** 2
        matrix = (sine * cross + versine * cross * cross).tolist()
        matrix = np.array([[float(c) for c in row] for row in matrix])
    # Each component to its own relative precision: a handful of roundings.
    np.testing.assert_allclose(q, exact, rtol=2e-15)
    np.testing.assert_allclose(back, rotation, rtol=2e-15)
    # Off the diagonal two parts of at most the angle's size are added.
    np.testing.assert_allclose(entries, matrix, rtol=2e-15, atol=1e-15 * min(length, 1))
    np.testing.assert_allclose(np.diag(entries), np.diag(matrix), rtol=2e-15)


def test_matrix_minus_identity_agrees_with_the_matrix_exponential(rng):
    turns = jnp.asarray(rng.normal(size=(20, 3)))
    ours = jax.vmap(quaternion.matrix_minus_identity)(turns)
    oracle = np.stack([rotation_matrix(turn) - np.eye(3) for turn in turns])
    np.testing.assert_allclose(ours, oracle, rtol=0, atol=ROUNDING)


# --- float32 ---


def every_scale(rng, largest_rad):
    """Float32 rotation vectors of lengths from 1e-30 rad up, random axes."""
    axes = rng.normal(size=(400, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    lengths = np.logspace(-30, np.log10(largest_rad), 400)
    return (lengths[:, None] * axes).astype(np.float32)


def relative_error(ours, exact):
    exact = np.asarray(exact, np.float64)
    error = np.linalg.norm(np.asarray(ours, np.float64) - exact, axis=-1)
    return error / np.linalg.norm(exact, axis=-1)


def test_exp_keeps_its_relative_precision_in_float32(rng):
    turns = every_scale(rng, np.pi)
    ours = jax.vmap(quaternion.exp)(jnp.asarray(turns))
    assert ours.dtype == jnp.float32
    exact = Rotation.from_rotvec(turns.astype(np.float64)).as_quat(scalar_first=True)
    angle = np.linalg.norm(turns.astype(np.float64), axis=1, keepdims=True)
    vector = np.sin(angle / 2) * (turns / angle)
    assert relative_error(ours[:, 1:], vector).max() < 4 * EPS32
    np.testing.assert_allclose(ours[:, 0], exact[:, 0], rtol=0, atol=2 * EPS32)


def test_log_keeps_its_relative_precision_in_float32(rng):
    turns = every_scale(rng, np.pi).astype(np.float64)
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    exact = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * turns / angle], 1)
    rounded = exact.astype(np.float32)
    ours = jax.vmap(quaternion.log)(jnp.asarray(rounded))
    # What the rounded quaternion says, not what it was before rounding.
    w, v = rounded[:, :1].astype(np.float64), rounded[:, 1:].astype(np.float64)
    sine = np.linalg.norm(v, axis=1, keepdims=True)
    oracle = 2 * np.arctan2(sine, w) * v / sine
    assert relative_error(ours, oracle).max() < 4 * EPS32


def test_angle_keeps_its_relative_precision_in_float32(rng):
    turns = every_scale(rng, np.pi)
    ours = jax.vmap(quaternion.angle)(jnp.asarray(turns))
    exact = np.linalg.norm(turns.astype(np.float64), axis=1)
    np.testing.assert_allclose(ours, exact, rtol=2 * EPS32)


@pytest.mark.parametrize("step_rad", [1e-5, 1e-4, 1e-3, 1e-2])
def test_rebased_increments_survive_float32(rng, step_rad):
    poses, steps = walk(rng, 22, step_rad)
    near_identity = jnp.asarray(quaternion.rebase(poses), jnp.float32)
    ours = quaternion.increments(near_identity)[1:]
    assert ours.dtype == jnp.float32
    # Rounding errs by eps x the offset, here a few steps: each step keeps 5 digits.
    assert relative_error(ours, steps).max() < 1e-5


def test_what_rebase_and_atan2_are_for(rng):
    poses, steps = walk(rng, 22, 1e-4)
    absolute = jnp.asarray(poses, jnp.float32)
    assert relative_error(quaternion.increments(absolute)[1:], steps).max() > 1e-4
    near_identity = jnp.asarray(quaternion.rebase(poses), jnp.float32)
    dots = jnp.clip(jnp.sum(near_identity[1:] * near_identity[:-1], axis=1), -1, 1)
    by_acos = 2 * jnp.arccos(dots)
    assert (abs(by_acos / 1e-4 - 1) > 0.5).any()  # the angle is lost altogether


def test_rebase_agrees_with_scipy(rng):
    poses, _ = walk(rng, 5, 1.0)
    poses[2] = -poses[2]  # the same rotation
    ours = quaternion.rebase(poses)
    rotations = scipy_rotation(poses)
    oracle = (rotations[0].inv() * rotations).as_quat(canonical=True, scalar_first=True)
    assert ours.dtype == np.float64
    np.testing.assert_array_equal(ours[0, 1:], np.zeros(3))
    np.testing.assert_allclose(ours, oracle, rtol=0, atol=ROUNDING)


def test_offsets_and_increments_agree_with_scipy(rng):
    poses, steps = walk(rng, 12, 0.2)
    rotations = scipy_rotation(poses)
    offsets = (rotations[0].inv() * rotations).as_rotvec()
    ours = quaternion.offsets(jnp.asarray(poses))
    np.testing.assert_allclose(ours, offsets, rtol=0, atol=ROUNDING)
    increments = quaternion.increments(jnp.asarray(poses))
    np.testing.assert_array_equal(increments[0], np.zeros(3))
    np.testing.assert_allclose(increments[1:], steps, rtol=0, atol=ROUNDING)


# --- derivatives where they could break ---


def all_finite(tree):
    return all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


# Compiled once: the points below differ in values only.
exp_jacobian = jax.jit(jax.jacfwd(quaternion.exp))
matrix_jacobian = jax.jit(jax.jacfwd(quaternion.matrix_minus_identity))
log_jacobian = jax.jit(jax.jacrev(quaternion.log))
angle_gradient = jax.jit(jax.grad(quaternion.angle))
slerp_jacobians = jax.jit(jax.jacrev(quaternion.slerp, argnums=(0, 1, 2)))


def test_exp_has_its_first_and_second_derivative_at_zero():
    zero = jnp.zeros(3)
    second = jax.jit(jax.jacfwd(jax.jacfwd(quaternion.exp)))(zero)
    first = np.vstack([np.zeros(3), np.eye(3) / 2])
    np.testing.assert_array_equal(exp_jacobian(zero), first)
    np.testing.assert_allclose(second[0], -np.eye(3) / 4, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(second[1:], np.zeros((3, 3, 3)))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_log_has_its_derivative_at_the_identity(sign):
    expected = sign * np.hstack([np.zeros((3, 1)), 2 * np.eye(3)])
    np.testing.assert_array_equal(log_jacobian(sign * IDENTITY), expected)


def test_log_has_a_finite_derivative_at_half_a_turn():
    assert all_finite(log_jacobian(jnp.array([0.0, 0.6, 0.0, 0.8])))


# Central differences err by 1e-10 and 1e-16 / 1e-5; next to a series' threshold the two
# branches differ by eps, which a step of 1e-5 turns into 1e-11.
@pytest.mark.parametrize("length", [0.0, 1e-10, 1e-4, 1.2e-4, 2.4e-4, 1.0, 3.0])
def test_derivatives_agree_with_differences(length):
    rotation = jnp.asarray(length * np.array([0.48, -0.6, 0.64]))
    q = quaternion.exp(rotation)
    for derivative, function, point in [
        (exp_jacobian, quaternion.exp, rotation),
        (matrix_jacobian, quaternion.matrix_minus_identity, rotation),
        (log_jacobian, quaternion.log, q),
    ]:
        differences = jacobian(lambda x, f=function: f(jnp.asarray(x)), point)
        np.testing.assert_allclose(derivative(point), differences, rtol=0, atol=1e-8)


def test_angle_has_the_unit_vector_as_gradient_and_exactly_zero_at_rest():
    np.testing.assert_array_equal(angle_gradient(jnp.zeros(3)), np.zeros(3))
    axis = np.array([0.48, -0.6, 0.64])
    for length in [1e-30, 1e-8, 1.0]:
        gradient = angle_gradient(jnp.asarray(length * axis))
        np.testing.assert_allclose(gradient, axis, rtol=1e-15)


@pytest.mark.parametrize("separation_rad", [0.0, 1e-12, 1e-4, 1.0, np.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slerp_gradients_are_finite_and_correct(separation_rad, sign):
    half = separation_rad / 2
    end = sign * jnp.array([np.cos(half), np.sin(half), 0.0, 0.0])
    jacobians = slerp_jacobians(IDENTITY, end, 0.3)
    assert all_finite(jacobians)
    if separation_rad < np.pi:  # the arc changes side at half a turn
        slerp = lambda start, end: quaternion.slerp(start, jnp.asarray(end), 0.3)
        by_end = jacobian(lambda x: slerp(IDENTITY, x), end)
        by_start = jacobian(lambda x: slerp(jnp.asarray(x), end), IDENTITY)
        np.testing.assert_allclose(jacobians[0], by_start, rtol=0, atol=1e-8)
        np.testing.assert_allclose(jacobians[1], by_end, rtol=0, atol=1e-8)


def test_increments_and_offsets_have_finite_gradients_at_rest():
    total = lambda q: quaternion.increments(q).sum() + quaternion.offsets(q).sum()
    assert all_finite(jax.jit(jax.grad(total))(jnp.tile(IDENTITY, (4, 1))))
