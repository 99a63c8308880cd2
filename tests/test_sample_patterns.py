import numpy as np
import pytest

from hmdjit import sample_patterns
from hmdjit.sample_patterns import MULTISAMPLE_COUNTS


@pytest.mark.parametrize("samples", MULTISAMPLE_COUNTS)
def test_multisample_positions_differ_and_lie_in_the_pixel_on_a_16th_grid(samples):
    pattern = sample_patterns.multisample(samples)
    assert pattern.shape == (samples, 2)
    assert len({tuple(position) for position in pattern}) == samples
    assert ((pattern >= -0.5) & (pattern < 0.5)).all()
    np.testing.assert_array_equal(pattern * 16, np.round(pattern * 16))


@pytest.mark.parametrize("samples", [4, 8, 16])
def test_multisample_rows_and_columns_hold_one_sample_each(samples):
    pattern = sample_patterns.multisample(samples)
    assert len(set(pattern[:, 0])) == samples
    assert len(set(pattern[:, 1])) == samples


def test_rotated_grid_has_one_sample_in_each_quadrant():
    pattern = sample_patterns.multisample(4)
    assert {tuple(signs) for signs in np.sign(pattern)} == {
        (1, 1),
        (1, -1),
        (-1, 1),
        (-1, -1),
    }


def test_rotated_grid_maps_to_itself_at_a_quarter_turn():
    pattern = sample_patterns.multisample(4)
    turned = {(-y, x) for x, y in pattern}
    assert turned == {(x, y) for x, y in pattern}


@pytest.mark.parametrize(
    ("samples", "mean"), [(1, 0), (2, 0), (4, 0), (8, 0), (16, -1 / 32)]
)
def test_multisample_mean(samples, mean):
    pattern = sample_patterns.multisample(samples)
    np.testing.assert_array_equal(pattern.mean(axis=0), [mean, mean])


@pytest.mark.parametrize("samples", [0, 3, 32, 2.5])
def test_multisample_refuses_other_counts(samples, untyped):
    with pytest.raises(ValueError, match="samples must be 1, 2, 4, 8 or 16, got"):
        sample_patterns.multisample(samples)


def test_a_pattern_may_be_changed_without_harm():
    sample_patterns.multisample(4)[:] = 0
    assert sample_patterns.multisample(4).any()


def test_centre_is_the_centre():
    np.testing.assert_array_equal(sample_patterns.centre(), [[0.0, 0.0]])


def test_ordered_grids():
    np.testing.assert_array_equal(sample_patterns.ordered_grid(1), [[0, 0]])
    two = np.array([(-4, -4), (4, -4), (-4, 4), (4, 4)]) / 16
    np.testing.assert_array_equal(sample_patterns.ordered_grid(2), two)
    axis = [-6, -2, 2, 6]
    four = np.array([(x, y) for y in axis for x in axis]) / 16
    np.testing.assert_array_equal(sample_patterns.ordered_grid(4), four)


@pytest.mark.parametrize("factor", [2, 3, 4, 5])
def test_an_ordered_grid_is_centred_and_even(factor):
    pattern = sample_patterns.ordered_grid(factor)
    np.testing.assert_allclose(pattern.mean(axis=0), 0, atol=1e-16)
    # Tiled over pixels, the samples are a grid with one spacing.
    axis = np.unique(pattern[:, 0])
    gaps = np.diff(np.append(axis, axis[0] + 1))
    np.testing.assert_allclose(gaps, 1 / factor, rtol=1e-14)


@pytest.mark.parametrize("factor", [0, -1, 1.5])
def test_ordered_grid_checks_its_factor(factor, untyped):
    with pytest.raises(ValueError, match="factor must be a whole number >= 1, got"):
        sample_patterns.ordered_grid(factor)


def test_scrambled_halton_starts_as_the_reverse_radix_sequence():
    first = [(0, 0), (1 / 2, 2 / 3), (1 / 4, 1 / 3), (3 / 4, 2 / 9), (1 / 8, 8 / 9)]
    first += [(5 / 8, 5 / 9), (3 / 8, 1 / 9), (7 / 8, 7 / 9)]
    first += [(1 / 16, 4 / 9), (9 / 16, 2 / 27)]
    points = sample_patterns.halton(10, first=0, scrambled=True)
    np.testing.assert_allclose(points, first, rtol=0, atol=1e-15)


def test_plain_halton_starts_at_its_first_index():
    first = [(1 / 2, 1 / 3), (1 / 4, 2 / 3), (3 / 4, 1 / 9), (1 / 8, 4 / 9)]
    np.testing.assert_allclose(sample_patterns.halton(4), first, rtol=0, atol=1e-15)
    later = sample_patterns.halton(2, first=3)
    np.testing.assert_allclose(later, first[2:], rtol=0, atol=1e-15)


@pytest.mark.parametrize("scrambled", [False, True])
def test_halton_fills_every_elementary_box_once(scrambled):
    # 2^3 x 3^2 boxes: the first 72 points have one in each.
    points = sample_patterns.halton(72, first=0, scrambled=scrambled)
    assert ((points >= 0) & (points < 1)).all()
    # 1e-12 lifts a third that was rounded down onto its box.
    boxes = np.floor(points * [8, 9] + 1e-12).astype(int)
    assert len({tuple(box) for box in boxes}) == 72


def test_accumulation_offsets_have_the_mean_of_the_reference_image():
    offsets = -sample_patterns.accumulation(128)  # of the picture
    np.testing.assert_allclose(offsets.mean(axis=0), [0.0039, 0.0056], atol=5e-5)


def test_halton_checks_its_range():
    with pytest.raises(ValueError, match="count must be a whole number >= 1, got 0"):
        sample_patterns.halton(0)
    with pytest.raises(ValueError, match="first must be a whole number >= 0, got -1"):
        sample_patterns.halton(2, first=-1)
