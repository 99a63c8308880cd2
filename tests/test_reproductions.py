"""Claims and their verdicts, colour pairs, the eye, and the colour-space experiment."""

import itertools
import math

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import hmdjit as hj
from hmdjit.camera import Region
from hmdjit.estimates.intervals import Interval
from hmdjit.frames.displacement import Reading
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import View
from hmdjit.metrics import DetailLoss
from hmdjit.reproductions import claims, color_space, eye, two_colored
from hmdjit.reproductions import color_space_claims as judged
from hmdjit.reproductions.claims import FAILS, HOLDS, UNTOLD
from hmdjit.reproductions.two_colored import TwoColored

CAMERA = hj.Camera(24, 18, fov_deg=6.0, refresh_hz=90.0)


# --- verdicts ---


def _interval(low, high):
    return Interval((low + high) / 2, low, high, (high - low) / 4, "made up")


@pytest.mark.parametrize(
    ("low", "high", "is_above", "is_within"),
    [
        (0.1, 0.4, HOLDS, HOLDS),
        (0.1, 0.6, HOLDS, UNTOLD),
        (0.6, 0.9, HOLDS, FAILS),
        (-0.2, 0.3, UNTOLD, HOLDS),
        (-0.9, 0.9, UNTOLD, UNTOLD),
        (-0.4, -0.1, FAILS, HOLDS),
        (-0.9, -0.6, FAILS, FAILS),
        (0.0, 0.0, UNTOLD, HOLDS),
        (math.nan, math.nan, UNTOLD, UNTOLD),
    ],
)
def test_a_verdict_is_that_of_the_whole_interval(low, high, is_above, is_within):
    found = _interval(low, high)
    assert claims.above(found) == is_above
    assert claims.within(found, 0.5) == is_within


def test_a_claim_of_several_holds_where_all_do_and_fails_where_one_does():
    assert claims.every([HOLDS, HOLDS]) == HOLDS
    assert claims.every([HOLDS, UNTOLD]) == UNTOLD
    assert claims.every([UNTOLD, FAILS, HOLDS]) == FAILS
    assert claims.every([]) == UNTOLD


# --- colour pairs ---


def _decode(gamma):
    return np.where(gamma <= 0.04045, gamma / 12.92, ((gamma + 0.055) / 1.055) ** 2.4)


def _lab(linear):
    matrix = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    share = linear @ matrix.T / matrix.sum(axis=1)
    f = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * 841 / 108 + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _difference(one, other):
    linear = _lab((_decode(one) + _decode(other)) / 2)
    gamma = _lab(_decode((one + other) / 2))
    return float(colour.difference.delta_E_CIE2000(linear, gamma))


def _distance(one, other):
    pair = _lab(_decode(one)), _lab(_decode(other))
    return float(colour.difference.delta_E_CIE2000(*pair))


def test_the_pairs_are_those_of_a_search_by_brute_force():
    levels, apart = 3, 20.0
    axis = np.round(np.linspace(0, 255, levels)).astype(int)
    codes = list(itertools.product(axis.tolist(), repeat=3))
    gamma = {code: np.array(code) / 255 for code in codes}
    pairs = list(itertools.combinations(codes, 2))
    known = {pair: _difference(*(gamma[c] for c in pair)) for pair in pairs}
    expected = []
    for pair in sorted(pairs, key=lambda pair: (-round(known[pair], 2), pair)):
        used = itertools.chain.from_iterable(expected)
        if all(_distance(gamma[a], gamma[b]) >= apart for a in used for b in pair):
            expected.append(pair)
    found = two_colored.most_different(3, levels=levels, apart=apart)
    assert [(pair.first, pair.second) for pair in found] == expected[:3]
    for pair in found:
        both = np.array([pair.first, pair.second]) / 255
        assert pair.difference == pytest.approx(_difference(*both), rel=1e-6)
        assert pair.gamma_mix == tuple(np.floor(255 * both.mean(axis=0) + 0.5))
        light = _decode(both).mean(axis=0)
        mix = np.array(pair.linear_mix) / 255
        np.testing.assert_allclose(_decode(mix), light, atol=0.005)
    with pytest.raises(ValueError, match=r"count must lie in \[1, \d+\] for 3 levels"):
        two_colored.most_different(len(expected) + 1, levels=levels, apart=apart)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count must be a whole number >= 1, got 0"),
        ({"levels": 1}, "levels must be a whole number >= 2, got 1"),
        ({"apart": -1.0}, "apart must lie in"),
    ],
)
def test_the_search_refuses_what_makes_no_sense(options, message):
    with pytest.raises(ValueError, match=message):
        two_colored.most_different(**options)


# --- two colours ---


def _view(offset=(0.0, 0.0, 0.0), samples=128):
    still = Motion(jnp.asarray(offset), jnp.zeros(3))
    region = Region(3, 2, 16, 12)
    return View(CAMERA, region, still, 0, Reading(reference_samples=samples))


def test_two_colours_are_those_of_the_exact_pattern_at_any_pose():
    first, second = np.array([0.1, 0.9, 0.3]), np.array([0.8, 0.2, 0.6])
    patterns = hj.scenes.honeycomb(), hj.scenes.checkerboard(1.0)
    offset = np.array([0.003, -0.007, 0.02])
    sample = np.array([[0.25, -0.25]])
    tilt = np.radians(7.0)
    source = TwoColored(patterns, 1, first, second, tilt_deg=7.0)
    (shown,) = source.seen(_view(offset), sample, {"color"})["color"]
    angle = np.linalg.norm(offset)
    kx, ky, kz = offset / angle
    cross = np.array([[0, -kz, ky], [kz, 0, -kx], [-ky, kx, 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    for row, column in itertools.product(range(12), range(16)):
        x = 3 + column + 0.5 + 0.25 - CAMERA.width_px / 2
        y = CAMERA.height_px / 2 - (2 + row + 0.5 - 0.25)
        focal = CAMERA.focal_px
        a, b, c = turn @ np.array([x / focal, y / focal, -1.0])
        a, b = np.cos(tilt) * a - np.sin(tilt) * b, np.sin(tilt) * a + np.cos(tilt) * b
        cells = np.floor(180 / np.pi * np.array([a, b]) / -c)
        expected = second if cells.sum() % 2 else first
        np.testing.assert_allclose(shown[:, row, column], expected, atol=1e-12)


@pytest.mark.parametrize("blur_px", [0.0, 1.0])
def test_the_reference_of_two_colours_is_their_mean_in_linear_light(blur_px):
    first, second = np.array([0.1, 0.9, 0.3]), np.array([0.8, 0.2, 0.6])
    offset = np.array([0.004, -0.002, 0.0])
    # An upright edge alone: its place in a pixel says all.
    edge = hj.scenes.checkerboard(100.0)
    source = TwoColored((edge,), 0, first, second, blur_px=blur_px)
    reference = np.asarray(source.reference(_view(offset)))
    focal, (up, right) = CAMERA.focal_px, np.tan(np.abs(offset[:2]))
    beyond_x = np.arange(3, 19) + 0.5 - CAMERA.width_px / 2 + focal * right
    beyond_y = CAMERA.height_px / 2 - np.arange(2, 14) - 0.5 + focal * up
    if blur_px:
        shares = [0.5 + 0.5 * special.erf(b / np.sqrt(2)) for b in (beyond_x, beyond_y)]
    else:
        shares = [np.clip(b + 0.5, 0, 1) for b in (beyond_x, beyond_y)]
    x, y = shares[0][None], shares[1][:, None]
    odd = (x + y - 2 * x * y)[..., None]
    light = _decode(first) + odd * (_decode(second) - _decode(first))
    error = np.abs(_decode(np.moveaxis(reference, 0, -1)) - light)
    assert np.max(error / np.abs(_decode(second) - _decode(first))) < 0.03


# --- the eye ---


def test_the_blur_is_one_arc_minute_at_half_its_height():
    camera = color_space.CAMERA
    px_per_deg = float(hj.camera.px_per_deg(camera, jnp.array([756.0, 840.0]))[0])
    half = 0.5 / 60 * px_per_deg  # px, half of the width
    sigma = eye.sigma_px(camera)
    assert math.exp(-((half / sigma) ** 2) / 2) == pytest.approx(0.5, rel=1e-5)


@pytest.mark.parametrize("sigma", [0.0, 0.065, 0.5, 2.0])
def test_a_blur_keeps_all_light_and_spreads_it_by_its_variance(sigma):
    taps = eye.weights(sigma)
    places = np.arange(len(taps)) - len(taps) // 2
    assert taps.sum() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-12)
    square = 1 / 12 if sigma >= 0.5 else 0.0  # a pixel's own, once it is resolved
    spread = (taps * places**2).sum()
    assert spread == pytest.approx(sigma**2 + square, rel=0.03, abs=0.005)


def test_seen_colour_errors_are_those_of_blurred_light():
    rng = np.random.default_rng(0)
    shown, reference = rng.random((2, 3, 12, 14))
    sigma = 0.7
    metric = eye.SeenColorError(sigma_px=sigma, id="seen")

    def seen(rgb):
        taps, light = eye.weights(sigma), _decode(np.moveaxis(rgb, 0, -1))
        reach = len(taps) // 2
        wide = np.pad(light, [(reach, reach)] * 2 + [(0, 0)], mode="edge")
        total = np.zeros_like(light)
        for i, j in itertools.product(range(len(taps)), repeat=2):
            total += taps[i] * taps[j] * wide[i : i + 12, j : j + 14]
        return _lab(total)

    expected = colour.difference.delta_E_CIE2000(seen(shown), seen(reference))
    found = metric.per_pixel(jnp.asarray(shown), None, jnp.asarray(reference))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    alike = metric.per_pixel(jnp.asarray(shown), None, jnp.asarray(shown))
    assert float(jnp.max(alike)) == 0.0


def test_blurs_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"sigma_px must lie in \[0, inf\), got -1"):
        eye.SeenColorError(sigma_px=-1.0, id="seen")


# --- the experiment ---


def _values(means, spread=0.01, extra=0.0):
    """Made-up errors of LL, LG, BL, BG; `extra` of the checkerboard's worst."""
    rng = np.random.default_rng(1)
    noise = spread * rng.standard_normal((4, 2, 4, 60))
    values = np.asarray(means, float)[:, None, None, None] + noise
    values[3, 0] += extra
    return values


@pytest.mark.parametrize(
    ("means", "extra", "spread", "expected", "order"),
    [
        ((1, 2.01, 2, 3), 1.0, 0.01, (HOLDS,) * 4, "LL > BL > LG > BG"),
        ((2, 1, 1, 1.9), -1.0, 0.01, (FAILS, HOLDS, FAILS, UNTOLD), None),
        ((1, 2, 1.5, 4), -1.0, 0.01, (HOLDS,) * 3 + (FAILS,), "LL > BL > LG > BG"),
        ((1, 3, 2, 3.5), 0.0, 0.01, (HOLDS, FAILS, HOLDS, UNTOLD), "LL > BL > LG > BG"),
        ((1, 1, 1, 1), 0.0, 1.0, (UNTOLD,) * 4, None),
    ],
)
def test_the_paper_s_claims_are_judged(means, extra, spread, expected, order):
    measure = judged.Measure(DetailLoss(), "squared error")
    values = _values(means, spread, extra)
    found = judged.claims_by(measure, values)
    assert tuple(claim.verdict for claim in found) == expected
    for claim in found:
        assert claim.low <= claim.value <= claim.high
        assert claim.unit == "code values^2"
        assert claim.source
    if order:
        assert judged.order(measure, values) == order
    rows = judged.measured(measure, values)
    assert len(rows) == 4 * 2 * 5
    pooled = {(r.condition, r.case): r.value for r in rows}
    assert pooled["LL", "honeycomb"] == pytest.approx(values[0, 1].mean())


def test_more_of_what_is_good_is_judged_the_other_way_round():
    class Likeness(DetailLoss):
        less_is_better = False

    more = judged.Measure(Likeness(), "likeness")
    found = judged.claims_by(more, -_values((1, 2.01, 2, 3), extra=1.0))
    assert {claim.verdict for claim in found} == {HOLDS}
    assert {claim.unit for claim in found} == {"less likeness"}
    assert "LL -1" in found[0].reason  # what was measured, as it is


def test_conditions_are_named_by_filter_and_space():
    ids = {name: technique.id for name, technique in color_space.conditions().items()}
    assert ids == {
        "LL": "ssaa2_lanczos2",
        "LG": "ssaa2_lanczos2_gamma",
        "BL": "ssaa2",
        "BG": "ssaa2_gamma",
    }
    assert jax.tree.leaves(color_space.CAMERA) == [110.0, 90.0]
