import jax
import jax.numpy as jnp
import numpy as np
import oracle_downsampling as oracle
import pytest
import small
from antialiasing_images import stack
from small import quickly

import hmdjit as hj
from hmdjit import color, techniques
from hmdjit.filters import downsampling
from hmdjit.simulation import session
from hmdjit.techniques import SSAA, HeadMovement

SPACES = ("linear", "gamma")
KERNELS = [("box", "exact"), ("lanczos2", "exact"), ("lanczos2", 11)]
STUDY = [SSAA(2, space, *kernel) for kernel in KERNELS for space in SPACES]
PIXELS = 20  # of 40 x 40 texels
CAMERA = hj.Camera(PIXELS, PIXELS, 20.0, 60.0)


def samples_of(large, factor=2):
    """Pictures `(..., 3, rows, columns)` as samples `(..., factor^2, 3, h, w)`."""
    places = [(k // factor, k % factor) for k in range(factor**2)]
    parts = [large[..., y::factor, x::factor] for y, x in places]
    return np.stack(parts, axis=-4)


@quickly
def resolved(samples):
    """All of `STUDY`, `(techniques, pictures, 3, height, width)`."""

    def each(technique):
        def one(planes):
            frame = hj.Frame(planes, CAMERA, hj.Region.whole(CAMERA))
            return technique.resolve(frame)

        return jax.vmap(one)(samples)

    return jnp.stack([each(technique) for technique in STUDY])


def expected(samples):
    return np.stack(
        [[oracle.ssaa(s, 2, t.space, t.filter, t.taps) for s in samples] for t in STUDY]
    )


@pytest.mark.parametrize(("dtype", "atol"), [(np.float64, 1e-9), (np.float32, 3e-6)])
def test_agrees_with_loops_over_a_large_picture(dtype, atol):
    # In float32: ten roundings of 6e-8, steepened by up to 13 where gamma is linear.
    samples = samples_of(stack()).astype(dtype)
    assert len(samples) >= 25
    ours = resolved(jnp.asarray(samples))
    assert ours.dtype == dtype
    np.testing.assert_allclose(ours, expected(samples), rtol=0, atol=atol)


@pytest.mark.parametrize("factor", [1, 3, 4])
def test_agrees_with_loops_at_other_factors(factor, rng):
    samples = rng.random((factor**2, 3, 5, 7))
    for taps in ("exact", 11):
        ours = quickly(downsampling.lanczos2, static_argnums=(1, 2))(
            jnp.asarray(samples), factor, taps
        )
        theirs = oracle.ssaa(samples, factor, "gamma", "lanczos2", taps)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_one_sample_per_pixel_stays():
    assert downsampling.lanczos2_weights(1) == {0: 1.0}


def test_weights_of_two_texels_per_pixel():
    weights = downsampling.lanczos2_weights(2)
    assert list(weights) == list(range(-3, 5))
    outwards = [0.43430, 0.11650, -0.04194, -0.00886]
    np.testing.assert_allclose([weights[k] for k in range(1, 5)], outwards, atol=5e-6)
    np.testing.assert_allclose([weights[-k] for k in range(4)], outwards, atol=5e-6)


@pytest.mark.parametrize("taps", ["exact", 11])
def test_constants_and_ramps_are_kept(taps):
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    ramp = 0.1 + 0.012 * x + 0.006 * y
    planes = np.stack([np.full_like(ramp, 0.3), ramp, ramp.T])
    ours = resolved(jnp.asarray(samples_of(planes)[None]))
    means = planes.reshape(3, PIXELS, 2, PIXELS, 2).mean(axis=(2, 4))
    for technique, found in zip(STUDY, np.asarray(ours)[:, 0], strict=True):
        np.testing.assert_allclose(found[0], 0.3, atol=1e-14)
        if technique.space == "gamma":  # a ramp of gamma is none of light
            inside = np.s_[:, 2:-2, 2:-2]
            np.testing.assert_allclose(found[inside], means[inside], atol=1e-14)


def response(weights, cycles_per_px):
    """Frequency response of texels' weights."""
    x = (np.array(list(weights)) - 0.5) / 2
    turns = np.cos(2 * np.pi * np.outer(cycles_per_px, x))
    return turns @ np.array(list(weights.values()))


@pytest.mark.parametrize("taps", ["exact", 11])
def test_lanczos_is_nearer_to_the_ideal_half_band_than_a_box(taps):
    f = np.linspace(0, 1, 1001)
    ideal = f < 0.5
    error = lambda weights: np.mean((response(weights, f) - ideal) ** 2)
    lanczos = error(downsampling.lanczos2_weights(2, taps))
    assert lanczos < 0.5 * error({0: 0.5, 1: 0.5})


def test_an_equal_mix_of_two_colors():
    a, b = np.array([1.0, 0.2, 0.7]), np.array([0.1, 0.9, 0.3])
    mixed = np.empty((3, 40, 40))
    checks = np.indices((40, 40)).sum(axis=0) % 2 == 0
    mixed[:] = np.where(checks, a[:, None, None], b[:, None, None])
    shown = np.asarray(resolved(jnp.asarray(samples_of(mixed)[None])))[:, 0]
    light = color.encode((color.decode(jnp.asarray(a)) + color.decode(b)) / 2)
    means = {"linear": np.asarray(light), "gamma": (a + b) / 2}
    for technique, found in zip(STUDY, shown, strict=True):
        if technique.filter == "box":
            wanted = np.broadcast_to(means[technique.space][:, None, None], found.shape)
            np.testing.assert_array_equal(found, wanted)


def test_beyond_the_edge_lies_the_outermost_texel():
    # One bright column of texels at the left, all else black: its weight is that of
    # all texels from there on.
    large = np.zeros((3, 40, 40))
    large[..., 0] = 0.5
    gamma = SSAA(2, "gamma", "lanczos2")
    shown = resolved(jnp.asarray(samples_of(large)[None]))[STUDY.index(gamma), 0]
    weights = downsampling.lanczos2_weights(2)
    first = sum(weight for texel, weight in weights.items() if texel <= 0) / 2
    second = sum(weight for texel, weight in weights.items() if texel <= -2) / 2
    np.testing.assert_allclose(shown[0, 5, 0], first, rtol=1e-13)
    np.testing.assert_allclose(shown[0, 5, 1:], max(second, 0), atol=1e-15)


def test_gradients_flow():
    def total(samples):
        return jnp.sum(
            downsampling.lanczos2(samples, 2) * jnp.arange(6.0)[None, :, None]
        )

    slopes = quickly(jax.grad(total))(jnp.full((4, 3, 6, 5), 0.5))
    assert jnp.isfinite(slopes).all()
    # Each texel counts once in all, of rows that weigh the same.
    rows = jnp.sum(slopes, axis=(0, 1, 3)) / 15
    np.testing.assert_allclose(rows.sum(), 15.0, rtol=1e-12)


# --- as a technique ---


@pytest.mark.parametrize("technique", STUDY, ids=lambda t: t.id)
def test_ids_name_what_is_not_the_default(technique):
    words = ["ssaa2"] + ["lanczos2"] * (technique.filter == "lanczos2")
    words += ["taps11"] * (technique.taps == 11)
    words += ["gamma"] * (technique.space == "gamma")
    assert technique.id == "_".join(words)
    assert techniques.by_id(technique.id) == technique
    blending = HeadMovement(resolve=technique)
    assert techniques.by_id(blending.id).id == blending.id


def test_only_the_box_reads_no_neighbor():
    for technique in STUDY:
        is_box = technique.filter == "box"
        assert technique.stencil_radius_px == (0 if is_box else 2)
        assert not technique.reads_supersampled
    assert not SSAA(4, filter="lanczos2").reads_supersampled
    assert SSAA(4).reads_supersampled


def test_laws_and_hints_hold():
    techniques.check(SSAA(2, "gamma", "lanczos2", 11))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filter": "lanczos"}, "^filter must be one of box, lanczos2, got 'lanczos'"),
        ({"taps": 11}, "^taps must be 'exact' with filter = 'box', got 11.$"),
        ({"filter": "lanczos2", "taps": 9}, "^taps must be 'exact' or 11, got 9.$"),
        ({"filter": "lanczos2", "taps": True}, "^taps must be 'exact' or 11, got"),
    ],
)
def test_what_is_unknown_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        SSAA(2, **options)
    with pytest.raises(ValueError, match=r"^texels must have factor\^2 = 9 planes"):
        downsampling.lanczos2(jnp.zeros((4, 3, 2, 2)), 3)


def test_a_tile_measures_the_same_as_its_block_of_the_whole_frame(rng):
    technique = SSAA(2, filter="lanczos2")
    texture = small.texture(rng)
    motion = hj.Motion.of(jnp.asarray(small.path(rng)))
    block = hj.Region(8, 6, 8, 6)
    around = hj.Region(6, 4, 12, 10)  # two pixels more on all sides

    def measured(region):
        return session.session(
            texture, small.CAMERA, (technique,), motion, region, block, warmup=2
        )[0]

    ours, whole = quickly(
        lambda: (measured(around), measured(hj.Region.whole(small.CAMERA)))
    )()
    assert whole.mtcd > 1
    np.testing.assert_allclose(ours.mtcd, whole.mtcd, rtol=1e-12)
    np.testing.assert_allclose(ours.detail_loss, whole.detail_loss, rtol=1e-12)
