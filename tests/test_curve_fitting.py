"""Fitting blending curves: measures, slopes, searches, errors and gains."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import scipy.optimize
import small
import viewing as views

import hmdjit as hj
from hmdjit import curve_fitting
from hmdjit.curve_fitting import CurveSpace, NoFitError, errors, front, search, viewing
from hmdjit.curve_fitting.problem import Linearized
from hmdjit.curve_fitting.results import FrontPoint, Kept
from hmdjit.curves import Cosine
from hmdjit.frames.displacement import GATHER, SLICES
from hmdjit.simulation import sharding as devices
from hmdjit.simulation.session import differentiable_session
from hmdjit.studies.measured_blocks import Tiles
from hmdjit.studies.runner import Runner
from hmdjit.studies.sessions import Sessions

CAMERA = hj.Camera(32, 32, fov_deg=4.0, refresh_hz=60.0)
WARMUP, FRAMES, TILE = 3, 4, 8


@functools.cache
def texture(dtype: Any = np.float32):
    return views.noise_texture(np.random.default_rng(1), CAMERA, 60, dtype=dtype)


@functools.cache
def batch(count=6, start=0):
    head = hj.HeadMotion.seated()
    sessions = Sessions(0, head, CAMERA, Tiles(1, TILE), 1 << 20, WARMUP + FRAMES)
    return sessions.batch(start, count)


def looking(count=6, *, lag=False, dtype: Any = np.float32):
    mine = batch(count)
    motion = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), mine.motion)
    turned = viewing.turned(mine._replace(motion=motion), 60.0, WARMUP).motion
    return viewing.Viewing(
        CAMERA,
        motion,
        jnp.asarray(mine.origins[:, 0]),
        turned if lag else None,
        WARMUP,
        TILE,
        12,
        SLICES,
        devices.mesh(),
    )


# --- what is measured ---


def test_a_turn_is_quick_and_over_when_measuring_begins():
    before, after = batch(6), viewing.turned(batch(6), 60.0, WARMUP)
    turn = np.degrees(
        np.linalg.norm(after.motion.offset - before.motion.offset, axis=-1)
    )
    np.testing.assert_allclose(turn[:, WARMUP:], viewing.TURN_DEG, atol=0.05)
    assert (turn[:, 0] < 1e-5).all()
    # What is measured moves as before, but for the axes that the turn has turned.
    still = np.linalg.norm(before.motion.increment[:, WARMUP + 1 :], axis=-1)
    moved = np.linalg.norm(after.motion.increment[:, WARMUP + 1 :], axis=-1)
    np.testing.assert_allclose(moved, still, rtol=1e-3)


@pytest.mark.slow
def test_sessions_are_measured_as_studies_measure_them():
    space = CurveSpace("power")
    point = jnp.asarray(space.starts()[0], jnp.float32)
    (ours,) = viewing.values(space, point, viewing.stacked([texture()]), looking())
    technique = jax.tree.map(float, space.technique(point))
    runner = Runner(CAMERA, Tiles(1, TILE), [technique], WARMUP, 6, batch(6), GATHER)
    (theirs,) = runner.run([technique], texture(), batch(6))
    np.testing.assert_allclose(ours[:, 0], theirs.mtcd, rtol=1e-4)
    np.testing.assert_allclose(ours[:, 1], theirs.detail_loss, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    "space", [CurveSpace("power", 2), CurveSpace("spline", 1, "spline")], ids=str
)
def test_slopes_are_those_of_differences(space):
    view = looking(2, lag=True, dtype=np.float64)
    point = space.starts()[0] + 0.3 * np.random.default_rng(2).normal(size=space.size)
    textures = viewing.stacked([texture(np.float64)])
    both = jax.jit(lambda at: viewing.values_and_slopes(space, at, textures, view))
    _, slopes = both(point)
    for i, axis in enumerate(np.eye(space.size)):
        step = 1e-5 * axis
        difference = (both(point + step)[0] - both(point - step)[0]) / 2e-5
        scale = np.abs(slopes).max(axis=(0, 1, 3))
        assert (np.abs(slopes[..., i] - difference) / scale).max() < 1e-5


@functools.cache
def at_bounds():
    """Flicker and detail loss, and both modes' slopes, in Kim et al.'s own numbers."""
    view = looking(1, dtype=np.float64)
    region = hj.Region.whole(CAMERA)
    motion = jax.tree.map(lambda leaf: leaf[0], view.motion)
    run = differentiable_session(WARMUP, SLICES)

    def measured(numbers):
        w_min, w_lb, h_max, closeness = numbers
        kim = hj.techniques.HeadMovement(w_min, w_lb, h_max, (closeness,))
        (result,) = run(texture(np.float64), CAMERA, (kim,), motion, region, region)
        return result.mtcd + result.detail_loss

    # Optimising the program would take longer than all the rest of the tests.
    return jax.jit(
        lambda n: (measured(n), jax.jacfwd(measured)(n), jax.grad(measured)(n)),
        compiler_options={"xla_backend_optimization_level": "0"},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "which", "inwards"),
    [
        ((1.0, 0.1, 9.0, 0.6), 0, -1),
        ((0.1, 0.1, 9.0, 0.6), 0, 1),  # where it is w_lb
        ((0.3, 0.0, 9.0, 0.6), 1, 1),
        ((0.3, 0.3, 9.0, 0.6), 1, -1),  # where it is w_min
        ((0.3, 0.1, 1e-3, 0.6), 2, 1),  # only the current picture is shown
        ((0.3, 0.1, 9.0, 0.0), 3, 1),
        # Exactly at 1 all read texels' centres, where bilinear slopes are those to the
        # right: a search is never there.
        ((0.3, 0.1, 9.0, 1 - 1e-7), 3, -1),
    ],
)
def test_slopes_at_the_bounds_are_one_sided_differences(numbers, which, inwards):
    numbers = jnp.asarray(numbers)
    here, forward, reverse = at_bounds()(numbers)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    step = 1e-5 * inwards * np.eye(4)[which]  # second order, one-sided
    near, far = (at_bounds()(numbers + i * step)[0] for i in (1, 2))
    difference = (4 * near - 3 * here - far) / (2e-5 * inwards)
    assert forward[which] == pytest.approx(float(difference), rel=1e-5, abs=1e-7)


# --- searching ---


def decay(point):
    rate, height = point
    t = np.linspace(0, 1, 20)
    curve = np.exp(-rate * t)
    return height * curve - (2 * np.exp(-3 * t) + 0.05 * t), np.stack(
        [-t * height * curve, curve], axis=1
    )


def searched(measured, start, **options):
    """Search with what JAX can neither differentiate nor make a batch of."""
    shapes = [jax.ShapeDtypeStruct(shape, float) for shape in ((20,), (20, 2))]
    linearize = lambda point: jax.pure_callback(measured, shapes, point)
    return search.least_squares(jax.tree_util.Partial(linearize), start, **options)


def test_a_search_ends_where_scipys_does_and_measures_once_per_step():
    asked = []

    def measured(point):
        asked.append(np.array(point))
        return decay(np.asarray(point))

    ours = searched(measured, np.ones(2), tolerance=1e-6)
    slopes: Any = lambda p: decay(p)[1]
    theirs = scipy.optimize.least_squares(
        lambda p: decay(p)[0], [1.0, 1.0], jac=slopes, xtol=1e-12
    )
    np.testing.assert_allclose(ours.point, theirs.x, rtol=1e-5)
    assert ours.why == search.CONVERGED
    # Neither again for slopes nor once per direction, and no point twice.
    assert len(asked) == len(np.unique(asked, axis=0)) == ours.steps


def test_a_search_says_why_it_ended():
    found = searched(lambda p: decay(np.asarray(p)), np.ones(2), most_steps=2)
    assert found.why == "stopped after 2 steps"
    for factors in ((np.nan, 1), (1, np.nan)):
        wrong = lambda p, each=factors: tuple(
            factor * part for factor, part in zip(each, decay(np.ones(2)), strict=True)
        )
        with pytest.raises(NoFitError, match="no finite number"):
            searched(wrong, np.ones(2))


class Tradeoff(eqx.Module):
    """Flicker `x^2` and detail loss `(1 - x)^2` of one number x, two sessions alike."""

    weight: float
    space: Any = eqx.field(static=True, default=None)

    def __call__(self, point):
        root = jnp.sqrt(self.weight)
        slopes = jnp.stack([jnp.ones(()), -root])
        return jnp.stack([point[0], root * (1 - point[0])]), slopes[:, None]

    def at(self, point):
        residuals, slopes = (np.asarray(part) for part in self(jnp.asarray(point)))
        x = point[0]
        each = lambda array: np.stack([array] * 2)[None]
        return Linearized(each(residuals), each(slopes), each([x**2, (1 - x) ** 2]))


TRADEOFF: Any = Tradeoff


def test_a_front_is_the_least_for_each_weight_and_meets_a_bound():
    found = front.Front(TRADEOFF, None, "", lambda line: None)
    found.first([np.array([0.5])])
    for weight in front.FRONT_WEIGHTS:
        best = found.along(weight)  # of x^2 + w (1 - x)^2
        np.testing.assert_allclose(best.point, weight / (1 + weight), atol=5e-3)
    weight = found.within(0.3)
    assert 0.29 < found.along(weight).detail_loss <= 0.3 * 1.002
    with pytest.raises(NoFitError, match=r"at least 0.001 times .*, got 1e-06"):
        found.within(1e-6)


def test_a_journal_keeps_finished_searches_of_the_same_fit(tmp_path):
    path = tmp_path / "fit.json"
    begun = lambda key: front.Front(TRADEOFF, path, key, lambda line: None)
    first = begun("key")
    best = first.first([np.array([0.5])])
    first.along(1.0)
    resumed = begun("key")
    kept = resumed.first([])
    np.testing.assert_array_equal(kept.point, best.point)
    assert kept[1:] == best[1:]
    resumed.along(1.0)
    assert resumed.steps == 0
    content = path.read_text()
    for other in (
        content.replace('"key": "key"', '"key": "k"'),
        "garbage",
        "[1]",
        "{}",
    ):
        path.write_text(other)
        with pytest.raises(ValueError, match="empty"):
            begun("key").first([])


# --- errors ---


def test_errors_of_a_mean_are_its_standard_error(rng):
    """A cost of `(x - y_i)^2` on one number: the sandwich is the textbook's."""
    y = rng.normal(size=40)
    space = CurveSpace("kim")
    point = np.asarray(space.starts()[0])
    gradients, curvatures = np.zeros((40, 4)), np.zeros((40, 4, 4))
    gradients[:, 2] = 2 * (y.mean() - y)  # of log h_max
    curvatures[:, 2, 2] = 2
    sure = errors.errors(space, point, gradients, curvatures)
    h_max = 25.0
    expected = h_max * y.std() / np.sqrt(40 - 4)
    assert sure.standard_error[2] == pytest.approx(expected, rel=1e-6)
    # Nothing says how far off the others are.
    assert (sure.standard_error[[0, 1, 3]] == np.inf).all()
    assert (sure.low[[0, 1, 3]] == 0).all()
    assert (sure.high[[0, 1, 3]] == 1).all()
    low, high = h_max * np.exp(np.array([-1.96, 1.96]) * expected / h_max)
    assert sure.low[2] == pytest.approx(low, rel=0.02)  # a tenth of the half-width
    assert sure.high[2] == pytest.approx(high, rel=0.02)


def test_newtons_step_ends_at_the_least_of_a_quadratic(rng):
    root = rng.normal(size=(5, 4, 4))
    curvatures = root @ np.swapaxes(root, 1, 2)
    least = 0.5 * rng.normal(size=4)
    gradients = -np.einsum("ipq,q->ip", curvatures, least)
    np.testing.assert_allclose(errors.newton_step(gradients, curvatures), least)


# --- gains ---


def kept(rng, flicker, detail):
    noise = 0.01 * rng.normal(size=(2, 50))
    return Kept(
        flicker + noise[0] - noise[0].mean(), detail + noise[1] - noise[1].mean()
    )


def test_a_gain_is_read_off_the_front_at_equal_detail_loss(rng):
    kim = hj.techniques.HeadMovement()
    front = [
        FrontPoint(w, kim, kept(rng, f, d))
        for w, f, d in ((1.0, 0.9, 1.0), (0.3, 0.7, 2.0), (0.1, 0.6, 4.0))
    ]
    gain = curve_fitting.gain_at_equal_detail(front, kept(rng, 0.8, 3.0))
    assert gain is not None
    assert gain.value == pytest.approx((0.8 - 0.65) / 0.8)
    assert 0 < gain.standard_error < 0.01
    assert curve_fitting.gain_at_equal_detail(front, kept(rng, 0.8, 5.0)) is None


def test_what_is_kept_is_as_sure_as_a_jackknife_says(rng):
    """Ratios of means, and gains at equal detail loss: all their parts vary."""
    person = np.exp(0.5 * rng.normal(size=(400, 1, 1)))
    own = np.exp(0.2 * rng.normal(size=(400, 6, 2)))
    levels = np.array([[1, 1], [0.9, 1], [0.7, 2], [0.6, 4], [0.8, 3], [0.5, 3]])
    measured = np.moveaxis(person * own * levels, 0, -1)[:, None]

    def told(measured):
        none, *others = measured
        *points, kim, fitted = (Kept.of(each, none) for each in others)
        technique = hj.techniques.HeadMovement()
        front = [FrontPoint(1.0, technique, each) for each in points]
        gain = curve_fitting.gain_at_equal_detail(front, kim)
        assert gain is not None
        return [kim.intervals()[0], fitted.gain_over(kim)[0], gain]

    left_out = [
        [one.value for one in told(np.delete(measured, i, axis=-1))] for i in range(400)
    ]
    error = np.sqrt(399 * np.var(left_out, axis=0))
    ours = [one.standard_error for one in told(measured)]
    np.testing.assert_allclose(ours, error, rtol=0.02)


# --- recovery ---

TRUTH = hj.techniques.HeadMovement(0.4, 0.1, 4.0, (0.5,))
SEEN = 40


@functools.cache
def spots():
    """Black and white: where past and present differ, they differ much."""
    rng = np.random.default_rng(2)
    sizes = 2 * (CAMERA.width_px + 2 * 60)
    smooth = oracles.smooth_noise(rng, sizes, sizes, 2.0)
    color = jnp.asarray(np.round(smooth), np.float32)
    return hj.Texture.of(color, color, 2, 60)


def _values(space, point, view):
    (found,) = viewing.values(space, point, viewing.stacked([spots()]), view)
    return np.asarray(found)


@functools.cache
def seen():
    """What sessions of the true curve do, and the space it is of."""
    space, view = CurveSpace("kim"), looking(SEEN)
    point = jnp.asarray(space.near(TRUTH), jnp.float32)
    return space, view, _values(space, point, view)


def recovered(seed, noise):
    space, view, exact = seen()
    rng = np.random.default_rng(seed)
    observed = exact + noise * exact.mean(axis=0) * rng.normal(size=exact.shape)
    return space, curve_fitting.recover(space, [spots()], view, observed[None])


@pytest.mark.slow
def test_a_known_curve_is_recovered_from_its_sessions():
    space, found = recovered(0, 0.0)
    truth = np.asarray(space.natural(space.near(TRUTH)))
    np.testing.assert_allclose(found.numbers, truth, rtol=2e-3)
    assert found.why == search.CONVERGED


@pytest.mark.exhaustive
def test_intervals_of_recovered_numbers_cover():
    """Of 200 intervals that cover with 95 %, fewer than 180 cover once in 500 times.

    Four numbers are looked at, so a false alarm has a chance below 1 %.
    """
    covered = np.zeros(4)
    space, _, _ = seen()
    truth = np.asarray(space.natural(space.near(TRUTH)))
    for seed in range(200):
        _, found = recovered(seed, 0.02)
        covered += (found.errors.low <= truth) & (truth <= found.errors.high)
    print("covered of 200:", dict(zip(space.names, covered, strict=True)))
    assert (covered >= 180).all(), covered


def test_what_cannot_be_recovered_is_refused():
    space, view, exact = CurveSpace("kim"), looking(SEEN), np.ones((SEEN, 2))
    few = jax.tree.map(lambda leaf: leaf[:8], (view.motion, view.origins))
    small = dataclasses.replace(view, motion=few[0], origins=few[1])
    with pytest.raises(NoFitError, match="sessions must be more than 8"):
        curve_fitting.recover(space, [spots()], small, exact[None, :8])
    with pytest.raises(NoFitError, match="observed must be finite"):
        curve_fitting.recover(space, [spots()], view, exact[None] * np.nan)
    # Without any blending detail is lost by rounding alone, of 1e-13: divided by that,
    # the search had "converged" where it began.
    for scale in (np.zeros(2), np.array([1.0, 1e-12])):
        with pytest.raises(NoFitError, match=r"observed must flicker .* than 1e-06"):
            curve_fitting.recover(space, [spots()], view, scale * exact[None])


_CURVES = {
    "w_lb 0": hj.techniques.HeadMovement(0.4, 0.0, 4.0, (0.5,)),
    "w_min 0": hj.techniques.HeadMovement(0.0, 0.0, 4.0, (0.5,)),
    "w_lb is w_min": hj.techniques.HeadMovement(0.4, 0.4, 4.0, (0.5,)),
    "closeness 0": hj.techniques.HeadMovement(0.4, 0.1, 4.0, (0.0,)),
    "closeness 1": hj.techniques.HeadMovement(0.4, 0.1, 4.0, (1.0,)),
    "h_max beyond any head": hj.techniques.HeadMovement(0.4, 0.1, 1e6, (0.5,)),
    "the least exponent": hj.techniques.HeadMovement(
        0.4, 0.1, 4.0, (0.5,), ease=Cosine(0.5)
    ),
}


def _seen_of(technique):
    """What sessions of a technique do that may lie at a bound, up to 1e-9 of it."""
    family = "power" if isinstance(technique.ease, Cosine) else "kim"
    space, view = CurveSpace(family), looking(SEEN)
    logit = lambda x: np.log(x / (1 - x))
    share = lambda x: logit(np.clip(x, 1e-9, 1 - 1e-9))
    w_min, w_lb = float(technique.w_min), float(technique.w_lb)
    point = [share(w_min), share(w_lb / w_min if w_min else 0.0)]
    point += [np.log(technique.h_max_deg_s), share(technique.closeness[0])]
    point += [np.log(1e-9)] if family == "power" else []
    at = jnp.asarray(point, jnp.float32)
    return space, view, _values(space, at, view)


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", _CURVES)
def test_curves_at_their_bounds_are_recovered_within_them(case, rng):
    space, view, exact = _seen_of(_CURVES[case])
    for noise in (0.0, 0.02):
        observed = exact + noise * exact.mean(axis=0) * rng.normal(size=exact.shape)
        found = curve_fitting.recover(space, [spots()], view, observed[None])
        least, most = space.ranges
        for numbers in (found.numbers, found.errors.low, found.errors.high):
            assert np.all((numbers >= least) & (numbers <= most))
        assert np.isfinite(found.numbers).all()
        is_told = np.isfinite(found.errors.standard_error)
        assert np.isfinite(found.errors.high[is_told]).all()
        assert not np.isnan([found.errors.low, found.errors.high]).any()
        assert np.all(found.errors.low <= found.errors.high)


# --- a whole fit ---


@pytest.fixture(scope="module")
def study():
    return hj.Study(
        scenes={"noise": hj.scenes.power_law_noise(seed=3)},
        techniques=(hj.techniques.NoAntialiasing(),),
        head=hj.HeadMotion.seated(),
        camera=hj.Camera(64, 64, fov_deg=6.0, refresh_hz=60.0),
        sessions=24,
        frames=FRAMES,
        warmup=WARMUP,
        measure=Tiles(1, 16),
        baseline="none",
    )


@pytest.mark.slow
def test_a_fit_is_on_the_front_and_resumes(study, tmp_path):
    journal, lines = tmp_path / "fit.json", []

    class Stopped(Exception):
        pass

    def stop_in_the_middle(line):
        lines.append(line)
        if journal.exists() and len(lines) > 6:
            raise Stopped

    space = CurveSpace("kim")
    with pytest.raises(Stopped):
        curve_fitting.fit(study, space, journal=journal, progress=stop_in_the_middle)
    resumed = curve_fitting.fit(study, space, journal=journal)
    assert journal.exists()  # until the caller has written the result
    whole = curve_fitting.fit(study, space)
    np.testing.assert_array_equal(resumed.numbers, whole.numbers)
    assert resumed.steps < whole.steps

    ids = {"none", "freeze", "ssaa4", "head_movement", "fitted"}
    assert set(whole.kept) == ids
    flicker, detail = whole.kept["none"].intervals()
    assert (flicker.low, flicker.high) == pytest.approx((1, 1))
    assert (detail.low, detail.high) == pytest.approx((1, 1))
    mean = {id: np.mean(kept, axis=1) for id, kept in whole.kept.items()}
    assert mean["freeze"][0] == 0
    # Along the front flicker falls where detail loss rises.
    points = sorted(tuple(np.mean(point.kept, axis=1)[::-1]) for point in whole.front)
    assert np.all(np.diff([flicker for _, flicker in points]) < 0)
    gain = curve_fitting.gain_at_equal_detail(whole.front, whole.kept["head_movement"])
    assert gain is not None
    assert gain.low > -0.02  # Kim's constants are in the family


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sessions": 8}, "sessions must be at least 16"),
        ({"measure": Tiles(2, 16)}, "one tile per session"),
        ({"scenes": {"plates": small.solids()}}, "must be pictures .* got plates"),
        pytest.param(
            {"scenes": {"grey": hj.scenes.checkerboard(dark=0.5, light=0.5)}},
            "there is no flicker to remove",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_sentence(study, change, words):
    with pytest.raises(NoFitError, match=words):
        curve_fitting.fit(dataclasses.replace(study, **change), CurveSpace())


@pytest.mark.slow
def test_a_loss_of_detail_out_of_reach_is_refused(study):
    with pytest.raises(NoFitError, match="detail loss must be at least"):
        curve_fitting.fit(study, CurveSpace(), detail_loss=1e-4)
