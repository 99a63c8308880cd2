import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, optimize, stats

import hmdjit as hj
from hmdjit.metrics import observers
from hmdjit.metrics.jod_scaling import negative_log_posterior, scaled

TRUE = np.array([0.0, 0.4, 1.0, 2.1])


def votes_of(first_wins, conditions=3):
    """Counts of pairs `{(i, j): (votes for i, votes for j)}`."""
    counts = np.zeros((conditions, conditions), int)
    for (i, j), (wins, losses) in first_wins.items():
        counts[i, j], counts[j, i] = wins, losses
    return counts


QUARTERS = votes_of({(0, 1): (25, 75), (1, 2): (25, 75)})
TWELVES = votes_of({(0, 1): (3, 9), (0, 2): (1, 11), (1, 2): (5, 7)})
UNANIMOUS = votes_of({(0, 1): (0, 12), (0, 2): (1, 11), (1, 2): (5, 7)})
INCOMPLETE = votes_of({(0, 1): (4, 16), (1, 2): (9, 11)})
ONE_VOTE = votes_of({(0, 1): (4, 16), (1, 2): (9, 11), (0, 2): (1, 0)})
STUDIES = {
    "quarters": QUARTERS,
    "twelves": TWELVES,
    "unanimous": UNANIMOUS,
    "incomplete": INCOMPLETE,
    "one vote": ONE_VOTE,
}


# --- what is minimised ---


@functools.cache
def area(wins, losses):
    """Integral of a likelihood over distances, JOD."""

    def log(x):
        z = x / 1.4826
        return wins * stats.norm.logcdf(z) + losses * stats.norm.logsf(z)

    peak = 1.4826 * stats.norm.ppf(wins / (wins + losses))
    # Relative to the peak, which may be 1e-30.
    found = [
        integrate.quad(lambda x: np.exp(log(x) - log(peak)), *ends, epsabs=1e-12)[0]
        for ends in ((peak - 20, peak), (peak, peak + 20))
    ]
    return sum(found) * np.exp(log(peak))


def moved(counts, i, j):
    wins, losses = int(counts[i, j]), int(counts[j, i])
    if min(wins, losses) > 0:
        return wins, losses
    return (1, losses - 1) if wins == 0 else (wins - 1, 1)


def loss(scores, counts, prior):
    """As it is described, in loops over both orders of each pair."""
    pairs = list(itertools.permutations(range(len(counts)), 2))
    pairs = [(i, j) for i, j in pairs if counts[i, j] + counts[j, i] > 0]
    total = 0.01 * np.mean(scores) ** 2
    for i, j in pairs:
        z = (scores[i] - scores[j]) / 1.4826
        total -= counts[i, j] * stats.norm.logcdf(z)
        total -= counts[j, i] * stats.norm.logsf(z)
        if prior:
            p, density = stats.norm.cdf(z), 0.0
            for pair in pairs:
                wins, losses = moved(counts, *pair)
                if wins > 0 and losses > 0:  # else it says nothing of a distance
                    density += p**wins * (1 - p) ** losses / area(wins, losses)
            total -= np.log(density / len(pairs) + 0.1)
    return total


@pytest.mark.parametrize("prior", [True, False])
@pytest.mark.parametrize("counts", STUDIES.values(), ids=STUDIES)
def test_the_loss_is_what_is_described(counts, prior, rng):
    for _ in range(3):
        scores = rng.normal(0, 1.5, len(counts))
        ours = negative_log_posterior(
            jnp.asarray(scores), jnp.asarray(counts), prior=prior
        )
        np.testing.assert_allclose(ours, loss(scores, counts, prior), rtol=1e-10)


def test_many_votes_on_a_pair_do_not_reach_a_floor():
    # 75:25 of 4,000 votes: probabilities of 1e-976.
    many = 40 * QUARTERS
    np.testing.assert_allclose(hj.metrics.jod(many), [-1, 0, 1], atol=1e-5)


# --- where it is least ---


@pytest.mark.parametrize("prior", [True, False])
def test_three_quarters_of_votes_are_one_jod(prior):
    ours = hj.metrics.jod(QUARTERS, prior=prior)
    np.testing.assert_allclose(ours, [-1, 0, 1], rtol=0, atol=1e-5)


def test_published_votes_without_a_prior():
    ours = hj.metrics.jod(TWELVES, prior=False)
    np.testing.assert_allclose(ours, [-0.9762, 0.2406, 0.7356], rtol=0, atol=5e-5)


@pytest.mark.parametrize("prior", [True, False])
@pytest.mark.parametrize("counts", STUDIES.values(), ids=STUDIES)
def test_scores_are_where_scipy_finds_the_least(counts, prior, rng):
    ours = np.asarray(hj.metrics.jod(counts, prior=prior))
    starts = [np.zeros(len(counts)), rng.normal(0, 1, len(counts))]
    found = [
        optimize.minimize(loss, start, (counts, prior), options={"gtol": 1e-6})
        for start in starts
    ]
    best = min(found, key=lambda each: each.fun)
    assert loss(ours, counts, prior) <= best.fun + 1e-9
    np.testing.assert_allclose(ours, best.x, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("counts", [TWELVES, 200 * TWELVES], ids=["few", "many"])
def test_single_precision_agrees(counts):
    double = hj.metrics.jod(counts)
    with jax.enable_x64(False):
        single = hj.metrics.jod(counts)
    assert (single.dtype, double.dtype) == (jnp.float32, jnp.float64)
    # A tenth of 0.3 JOD, the standard error of 12 votes; of 2,400 that is 0.02 JOD.
    atol = 0.03 / np.sqrt(counts[0, 1] / 3)
    np.testing.assert_allclose(single, double, rtol=0, atol=atol)


def test_a_condition_may_be_given_its_score():
    free, fixed = hj.metrics.jod(TWELVES), hj.metrics.jod(TWELVES, fixed=(1, 4.0))
    np.testing.assert_allclose(fixed[1], 4.0, rtol=1e-15)
    np.testing.assert_allclose(jnp.diff(fixed), jnp.diff(free), rtol=1e-12)
    np.testing.assert_allclose(jnp.mean(free), 0, atol=1e-15)


def test_conditions_may_lie_far_apart_where_others_lie_between():
    true = np.arange(0.0, 9.0, 2.0)
    share = stats.norm.cdf((true[:, None] - true) / 1.4826)
    counts = np.triu(np.round(30 * share), 1)
    counts += np.tril(30 - counts.T, -1)
    ours = hj.metrics.jod(counts)
    farther = np.append(ours[:-1], ours[-1] + 0.01)
    assert loss(farther, counts, True) > loss(ours, counts, True)
    np.testing.assert_allclose(ours, true - 4, rtol=0, atol=0.3)
    assert ours[-1] - ours[0] > 7


def test_the_order_of_conditions_does_not_matter():
    order = [2, 0, 1]
    ours = hj.metrics.jod(UNANIMOUS[np.ix_(order, order)])
    usual = np.asarray(hj.metrics.jod(UNANIMOUS))
    np.testing.assert_allclose(ours, usual[order], atol=1e-6)
    np.testing.assert_allclose(hj.metrics.jod(UNANIMOUS.T), -usual, atol=1e-6)


def test_a_prior_keeps_unanimous_votes_near():
    ten = votes_of({(0, 1): (0, 10), (1, 2): (0, 10)})
    gaps = np.diff(hj.metrics.jod(ten))
    assert ((gaps > 2) & (gaps < 3)).all()
    with pytest.raises(ValueError, match="prior=False, got a group that won all"):
        hj.metrics.jod(ten, prior=False)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([[0, 1, 2], [1, 0, 2]], r"^counts must be \(conditions, conditions\), of two"),
        ([[0]], r"^counts must be \(conditions, conditions\), of two or more, got"),
        ([[0, -1], [2, 0]], "^counts must be whole numbers >= 0 of votes, got -1.$"),
        ([[0, 0.7], [0.3, 0]], "^counts must be whole numbers >= 0 of votes, got 0.7"),
        ([[0, np.nan], [2, 0]], "^counts must be whole numbers >= 0 of votes, got nan"),
        ([[0, np.inf], [2, 0]], "^counts must be whole numbers >= 0 of votes, got inf"),
        ([[3, 1], [2, 0]], "^counts must be 0 on the diagonal.* itself, got 3.$"),
        (np.diag([2, 2], 2) + np.diag([1, 1], -2), "^counts must connect all"),
        (np.diag([1, 1], 1), "^counts must place all conditions, got some"),
    ],
)
def test_what_are_no_votes_is_refused(counts, message):
    with pytest.raises(ValueError, match=message):
        hj.metrics.jod(np.asarray(counts))


def test_what_is_out_of_range_is_refused(key):
    with pytest.raises(ValueError, match=r"^fixed\[0\] must lie in \[0, 2\], got 3.$"):
        hj.metrics.jod(TWELVES, fixed=(3, 4.0))
    with pytest.raises(ValueError, match=r"^counts must be of two observers"):
        hj.metrics.jod_intervals(key, TWELVES[None])
    with pytest.raises(ValueError, match=r"^scores must be \(conditions,\), of two"):
        observers.votes(key, np.array([1.0]), 3)
    with pytest.raises(ValueError, match=r"^scores\[1\] must lie in .* got nan.$"):
        observers.votes(key, np.array([1.0, np.nan]), 3)
    with pytest.raises(ValueError, match=r"^half_width_jod must lie in \(0, inf\)"):
        observers.plan(key, TRUE, 0.0)


def test_inside_compiled_code_an_error_is_nan():
    assert jnp.isnan(scaled(jnp.asarray(0 * TWELVES), True)).all()
    assert jnp.isnan(scaled(jnp.asarray(votes_of({(0, 1): (9, 9)})), True)).all()
    traced = jax.eval_shape(hj.metrics.jod, jnp.asarray(TWELVES))
    assert traced.shape == (3,)


# --- observers ---


def test_votes_are_drawn_by_their_probabilities(key):
    drawn = np.asarray(observers.votes(key, TRUE, 2000, 3))
    both = drawn + np.swapaxes(drawn, 1, 2)
    np.testing.assert_array_equal(
        both, np.broadcast_to(3 * (1 - np.eye(4)), both.shape)
    )
    p = stats.norm.cdf((TRUE[:, None] - TRUE) / 1.4826)
    error = np.sqrt(p * (1 - p) / 6000)
    off = ~np.eye(4, dtype=bool)
    assert (np.abs(drawn.mean(axis=0) / 3 - p)[off] < 4 * error[off]).all()


def test_observers_who_differ_draw_votes_together(key):
    # One who has seen a condition once as better has so again: votes vary more.
    alike, apart = (
        observers.votes(own, np.zeros(2), 500, 8, spread_jod=spread)[:, 0, 1]
        for own, spread in zip(jax.random.split(key), (0.0, 1.5), strict=True)
    )
    binomial = 8 / 4
    assert abs(alike.var() - binomial) < 4 * binomial * np.sqrt(2 / 500)
    assert apart.var() > 2 * binomial


@pytest.mark.slow
def test_intervals_hold_the_scores_and_narrow_with_observers(key):
    widths = []
    for number in (10, 40):
        drawn = observers.votes(jax.random.fold_in(key, number), TRUE, number, 2)
        own = jax.random.fold_in(key, 1000 + number)
        found = hj.metrics.jod_intervals(own, drawn, fixed=(0, 4.0), resamples=300)
        assert (found.low <= found.scores).all()
        assert (found.scores <= found.high).all()
        assert found.low[0] == found.high[0] == 4.0
        assert found.failed == 0
        widths.append(np.mean(found.high - found.low))
    assert 1.4 < widths[0] / widths[1] < 3.2  # sqrt(4), and its spread


@pytest.mark.slow
def test_a_plan_finds_how_many_observers_a_study_needs(key):
    one, same = (jax.random.fold_in(key, 0) for _ in range(2))
    found = observers.plan(one, TRUE, 0.4, observers=(40, 10, 20), studies=100)
    assert found.observers == (10, 20, 40)
    low, middle, high = found.half_widths_jod
    # Standard deviations err by 7 %, and fall with the root of the observers.
    assert low / high == pytest.approx(2, rel=0.35)
    assert high < middle < low
    assert (
        found.needed == (10, 20, 40)[sum(width > 0.4 for width in (low, middle, high))]
    )
    alike = observers.plan(same, TRUE, 1e-3, observers=(10, 20, 40), studies=100)
    assert alike.half_widths_jod == found.half_widths_jod
    assert alike.needed is None


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say(key):
    """Of the true scores, over studies; the prior draws scores together a little."""
    studies, held = 80, []
    centred = TRUE - TRUE.mean()
    for number in range(studies):
        of_votes, of_resamples = jax.random.split(jax.random.fold_in(key, number))
        drawn = observers.votes(of_votes, TRUE, 20, 2)
        found = hj.metrics.jod_intervals(of_resamples, drawn, resamples=300)
        held.append((found.low <= centred) & (centred <= found.high))
    # Four scores that sum to 0 are three: 1.4 % of error, thrice; and what the prior's
    # pull and the bootstrap's own levels may add, 1 %. (150 studies: 94.3 %.)
    assert abs(np.mean(held) - 0.95) < 0.052
