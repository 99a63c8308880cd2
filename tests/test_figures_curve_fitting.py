import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from hmdjit import blending
from hmdjit.curve_fitting import CurveFit, CurveSpace
from hmdjit.curve_fitting.errors import Errors
from hmdjit.curve_fitting.results import FrontPoint, Kept
from hmdjit.curves import Cosine
from hmdjit.figures import curve_fitting as figures
from hmdjit.reports import curve_fitting as report
from hmdjit.techniques import HeadMovement, curve_file

SESSIONS = 48


def kept(flicker, detail_loss, spread=0.01, pattern=(1.0, -1.0)):
    """What a technique keeps, with exactly these means."""
    wave = spread * np.resize(pattern, SESSIONS)
    return Kept(flicker * (1 + wave), detail_loss * (1 + np.roll(wave, 1)))


def fitted(space=None, *, kim=(0.6, 1.5), curve=(0.5, 1.5), spread=0.01, reach=3.0):
    """Fit of round numbers, whose front is flicker 1 - x/3 at detail loss x."""
    space = space or CurveSpace()
    point = space.near(HeadMovement(w_min=0.2, w_lb=0.1, h_max_deg_s=12.0))
    numbers = np.asarray(space.natural(point))
    points = np.asarray(point) + 0.1 * np.linspace(-1, 1, 41)[:, None]
    drawn = np.asarray(jax.vmap(space.natural)(jnp.asarray(points)))
    front = [
        FrontPoint(1 / x, HeadMovement(), kept(1 - x / 3, x, spread))
        for x in np.linspace(0.5, reach, 5)
    ]
    own = {
        "none": kept(1.0, 1.0, spread),
        "freeze": kept(0.0, 40.0),
        "ssaa4": kept(0.8, 0.0),
        "head_movement": kept(kim[0], kim[1], spread, (1.0, 1.0, -1.0, -1.0)),
        "fitted": kept(curve[0], curve[1], spread),
    }
    sure = Errors(0.1 * numbers, 0.8 * numbers, 1.2 * numbers, drawn)
    technique = jax.tree.map(float, space.technique(point))
    return CurveFit(
        space, technique, 0.1, 1.5, numbers, sure, "converged", 9, own, {}, front
    )


@pytest.mark.parametrize("difference", [0.0, 0.2, 1.0])
def test_the_drawn_weight_is_that_of_the_equations(difference):
    technique = HeadMovement(w_min=0.4, w_lb=0.1, h_max_deg_s=20.0, ease=Cosine(1.0))
    for speed in (0.0, 5.0, 20.0, 30.0):
        w = 0.4 - 0.3 * difference
        rise = (1 - np.cos(np.pi * min(speed / 20, 1))) / 2
        got = figures.current_weight(
            technique, jnp.asarray(speed), jnp.asarray(difference)
        )
        np.testing.assert_allclose(got, w + (1 - w) * rise, rtol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 25.0])
def test_the_drawn_weight_has_finite_slopes_at_rest_and_at_h_max(speed):
    slope = jax.grad(figures.current_weight, argnums=(1, 2))
    slopes = slope(HeadMovement(), jnp.asarray(speed), jnp.asarray(0.0))
    assert np.isfinite(np.asarray(slopes)).all()


def test_bands_hold_the_curve_and_are_those_of_the_bootstrap():
    fit = fitted()
    figure = figures.draw_curve(fit, "footer")
    (axes,) = figure.axes
    (band,) = axes.collections
    edges = np.asarray(band.get_paths()[0].vertices)
    line = np.asarray(axes.lines[0].get_xydata())
    for speed, weight in line[::20]:
        at = edges[np.isclose(edges[:, 0], speed), 1]
        assert at.min() <= weight + 1e-9
        assert at.max() >= weight - 1e-9
    # At rest the weight is w_min: its quantiles are the band's ends.
    at = edges[np.isclose(edges[:, 0], 0), 1]
    w_min = fit.errors.drawn[:, 0]
    bounds = np.quantile(w_min, [0.025, 0.975])
    np.testing.assert_allclose([at.min(), at.max()], bounds, rtol=1e-9)


@pytest.mark.slow
def test_a_free_localisation_has_its_own_panel():
    fit = fitted(CurveSpace("spline", 2, "spline"))
    figure = figures.draw_curve(fit, "footer")
    _, right = figure.axes
    ours = np.asarray(right.lines[0].get_xydata())
    technique = fit.technique
    np.testing.assert_allclose(ours[0], [0, float(technique.w_min)], atol=1e-12)
    np.testing.assert_allclose(ours[-1], [1, float(technique.w_lb)], atol=1e-12)
    middle = blending.localized_minimum(
        technique.w_min, technique.w_lb, jnp.asarray(0.5), technique.localization
    )
    np.testing.assert_allclose(ours[100, 1], middle, rtol=1e-12)


def test_the_front_is_drawn_with_its_neighbours():
    figure = figures.draw_front(fitted(), "A gain.", "The footer.")
    (axes,) = figure.axes
    drawn = np.asarray(axes.lines[0].get_xydata())
    np.testing.assert_allclose(drawn[:, 1], 1 - drawn[:, 0] / 3, rtol=1e-9)
    low, high = axes.get_xlim()
    assert low < 0.5 < 3.0 < high < 10  # freeze, at 40, does not squeeze the rest
    words = " ".join(text.get_text() for text in figure.texts).replace("\n", " ")
    assert "freeze, flicker 0 at a detail loss of 40" in words
    assert "A gain. Bars: 95 %" in words
    assert "The footer." in words
    names = {text.get_text() for text in axes.texts}
    assert {"Kim et al.", "fitted", "no anti-aliasing"} <= names


def test_gains_are_told_in_percent_of_kims_flicker():
    # At a detail loss of 1.5 the front has 0.5: 0.1 less than 0.6.
    gain = report.gain_percent(fitted())
    assert gain is not None
    np.testing.assert_allclose(gain.value, 100 / 6, rtol=1e-9)
    assert gain.low < gain.value < gain.high
    assert "16.7 % less flicker [" in report.gain_sentence(fitted())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kim": (0.5, 1.5), "spread": 0.1}, "on the front within what these"),
        ({"kim": (0.4, 1.5)}, "25.0 % more flicker ["),
        ({"reach": 1.0, "curve": (0.6, 1.2)}, "does not reach the detail loss"),
    ],
)
def test_what_is_no_gain_is_not_told_as_one(changes, words):
    assert words in report.gain_sentence(fitted(**changes))


def test_pairs_are_told_by_session():
    fit = fitted(curve=(0.45, 1.8))
    sentence = report.pair_sentence(fit.kept)
    assert "25.0 % less flicker [" in sentence
    assert "20.0 % more detail loss [" in sentence
    same = fitted(kim=(0.5, 1.5)).kept
    assert "same within what these sessions can tell" in report.pair_sentence(same)


def test_tables_have_all_numbers():
    fit = fitted(CurveSpace("power", 2))
    console = Console(width=200, record=True)
    console.print(report.numbers_table(fit), report.kept_table(fit.kept))
    printed = console.export_text()
    for name, value in zip(fit.space.names, fit.numbers, strict=True):
        (line,) = (row for row in printed.splitlines() if row.startswith(name))
        assert f"{value:.4g}" in line
    assert "fitted curve" in printed
    kim = dict(zip(fit.space.names, report.kim_numbers(fit), strict=True))
    assert kim["closeness[1]"] is None
    assert kim["ease.exponent"] == pytest.approx(2)
    assert kim["h_max_deg_s"] == pytest.approx(25)


def test_a_curve_knows_where_it_is_from(tmp_path):
    fit, path = fitted(), tmp_path / "curve.toml"
    about = report.provenance(fit, {"scenes": ["cat"], "seed": 3}, 0.5)
    curve_file.write(path, fit.technique, about={"fit": about})
    assert curve_file.read(path).w_min == fit.technique.w_min
    assert about["standard_error"]["w_min"] == pytest.approx(0.02)
    assert about["fitted_flicker"]["mean"] == pytest.approx(0.5)
    assert about["lag_weight"] == 0.5
    assert about["search"] == "converged"
    assert not [key for key in about if key.startswith("held_out_")]
