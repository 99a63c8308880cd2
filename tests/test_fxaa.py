"""FXAA against an oracle of loops, and its laws."""

import functools

import antialiasing_images
import jax
import jax.numpy as jnp
import numpy as np
import oracle_fxaa
import pytest
from antialiasing_images import SIZE_PX, half_plane, of_two
from jax.test_util import check_grads
from small import quickly

import hmdjit as hj
from hmdjit.techniques import FXAA

CAMERA = hj.Camera(SIZE_PX, SIZE_PX, 40.0, 60.0)
PRESETS = ("white_paper", "10", "12", "15", "29", "39")
FORMS = [(preset, "gamma") for preset in PRESETS]
FORMS += [("white_paper", "linear"), ("39", "linear")]
QUICK = {("white_paper", "gamma"), ("39", "linear")}


def resolve(image, preset, space="gamma"):
    frame = hj.Frame(image[None], CAMERA, hj.Region.whole(CAMERA))
    return FXAA(preset, space).resolve(frame)


@functools.cache
def resolving(preset, space="gamma"):
    return quickly(jax.vmap(lambda image: resolve(image, preset, space)))


def stacked(some):
    """Pictures, filled up to one number for all: one program."""
    some = np.asarray(some)
    count = len(antialiasing_images.images())
    return np.concatenate([some, np.zeros((count - len(some), *some.shape[1:]))])


def shown(some, preset="white_paper", space="gamma"):
    return np.asarray(resolving(preset, space)(jnp.asarray(stacked(some))))[: len(some)]


@pytest.mark.parametrize(
    ("preset", "space"),
    [
        pytest.param(*form, marks=() if form in QUICK else pytest.mark.slow)
        for form in FORMS
    ],
)
def test_fxaa_agrees_with_an_oracle_of_loops(preset, space):
    images = antialiasing_images.stack()
    assert len(images) >= 25
    both = [oracle_fxaa.fxaa(image, preset, space) for image in images]
    expected, margin = (np.stack(part) for part in zip(*both, strict=True))
    assert 0.1 < np.mean(np.any(expected != images, axis=1)) < 0.6
    ours = shown(images, preset, space)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)
    single = resolving(preset, space)(jnp.asarray(images, jnp.float32))
    assert single.dtype == jnp.float32
    # Luma of up to 3 rounded a few times; encoding steepens dark colours by up to 13.
    is_decided = margin > 2e-6
    assert is_decided.mean() > 0.999
    error = np.abs(np.asarray(single) - expected).max(axis=1)
    assert error[is_decided].max() < 5e-6


def test_constants_gradients_and_faint_edges_are_left_alone(rng):
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX] / SIZE_PX
    ramps = [of_two(np.ones_like(x, bool), rng.random(3))]
    ramps += [np.stack([0.2 + 0.6 * t] * 3) for t in (x, y, (x + y) / 2)]
    ramps.append(of_two(half_plane(12), (0.5, 0.5, 0.5), (0.53, 0.53, 0.53)))
    for preset in ("white_paper", "39"):
        np.testing.assert_array_equal(shown(ramps, preset), np.asarray(ramps))


BOTH = pytest.mark.parametrize("preset", ["white_paper", "39"])


@BOTH
def test_a_moved_picture_is_shown_moved(rng, preset):
    # Around it lies one colour, so that the border's repetition changes nothing.
    framed = np.full((2, 3, SIZE_PX, SIZE_PX), 0.5)
    framed[0, :, 8:-8, 8:-8] = rng.random((3, 24, 24))
    framed[1, :, 8:-8, 8:-8] = antialiasing_images.images()["wires"][:, 8:-8, 8:-8]
    usual = shown(framed, preset)
    moved = shown(np.roll(framed, (3, -5), axis=(-1, -2)), preset)
    np.testing.assert_array_equal(moved, np.roll(usual, (3, -5), axis=(-1, -2)))
    assert (usual != framed).mean() > 0.05


def is_tied(image, preset):
    """Whether an edge might as well be level as upright."""
    red, green, blue = image
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    if preset == "white_paper":
        luma = (red + 1.963211 * green) / 4
    near = np.pad(luma, 1, mode="edge")

    def bend(near):
        columns = np.abs(near[:-2] - 2 * near[1:-1] + near[2:])
        return columns[:, :-2] + 2 * columns[:, 1:-1] + columns[:, 2:]

    return np.abs(bend(near) - bend(near.T).T) < 1.1e-5


@BOTH
def test_a_transposed_picture_is_shown_transposed_but_for_ties(rng, preset):
    # On a tie an edge counts as level. Ties are exact, whatever the colours, where a
    # pixel and its four corners all stand out from the pixels between them.
    noise = rng.random((3, SIZE_PX, SIZE_PX))
    both = np.stack([noise, *(of_two(half_plane(a, 0.3)) for a in (12, 45))])
    usual, turned = shown(both, preset), shown(np.swapaxes(both, -1, -2), preset)
    error = np.abs(np.swapaxes(turned, -1, -2) - usual).max(axis=1)
    tied = np.stack([is_tied(image, preset) for image in both])
    assert error[~tied].max() < 1e-14
    assert 0 < tied[0].mean() < 0.15
    assert (error[0, tied[0]] > 0).any()


@BOTH
def test_a_long_edge_comes_closer_to_its_coverage(preset):
    fine = (np.arange(40 * 32) + 0.5) / 32
    for angle in (2.5, 5, 12, 93):
        away = np.sin(np.radians(angle)) * (fine - 20)
        away = away - np.cos(np.radians(angle)) * (fine[:, None] - 20)
        coverage = (away > 0.3).reshape(40, 32, 40, 32).mean(axis=(1, 3))
        (ours,) = shown([of_two(half_plane(angle, 0.3))], preset)
        rms = [
            np.sqrt(np.mean((plane - coverage)[4:-4, 4:-4] ** 2))
            for plane in (half_plane(angle, 0.3), ours[0])
        ]
        assert rms[1] < 0.6 * rms[0], angle


@BOTH
def test_in_linear_light_the_same_shares_are_mixed(preset):
    # Between black and white, what is shown in gamma is the share of white.
    edges = [of_two(half_plane(angle, 0.3)) for angle in (5, 26.565, 71, 135)]
    share, linear = shown(edges, preset), shown(edges, preset, "linear")
    np.testing.assert_allclose(linear, oracle_fxaa.encoded(share), rtol=0, atol=1e-12)
    assert ((share > 0.01) & (share < 0.99)).any()


@pytest.mark.parametrize(
    "preset", [pytest.param("white_paper", marks=pytest.mark.slow), "39"]
)
def test_derivatives_are_those_of_colours_and_shares(rng, preset):
    image, weights = jnp.asarray(rng.random((2, 3, SIZE_PX, SIZE_PX)))
    total = lambda image: jnp.sum(weights * resolve(image, preset, "linear"))
    check_grads(jax.jit(total), (image,), order=1, modes=["rev"], eps=1e-7)
    assert jnp.isfinite(quickly(jax.grad(total))(0 * image)).all()


@pytest.mark.slow
def test_it_keeps_the_laws_of_techniques():
    hj.techniques.check(FXAA("10"))


def test_ids_say_what_is_not_the_default_and_choices_are_checked():
    for preset in PRESETS:
        for space in ("gamma", "linear"):
            technique = FXAA(preset, space)
            assert hj.techniques.by_id(technique.id) == technique
    assert FXAA().id == "fxaa"
    assert FXAA("39", "linear").id == "fxaa39_linear"
    assert FXAA().stencil_radius_px == 32
    assert FXAA("39").stencil_radius_px == 19
    with pytest.raises(ValueError, match="preset must be one of white_paper, 10, 12"):
        FXAA("40")
    with pytest.raises(ValueError, match="space must be one of gamma, linear"):
        FXAA(space="srgb")
