"""A technique of a user's own, who says no more than the contract asks for."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.frames.sources import History
from hmdjit.sample_patterns import ordered_grid
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.techniques import HeadMovement, NoAntialiasing, check

CAMERA = hj.Camera(48, 48, 6.0, 60.0)
HEAD = hj.HeadMotion.fixating()
SESSIONS = 48


class Average(hj.techniques.AbstractTechnique):
    """Exponential average along the head's rotation."""

    share: float = 0.2

    @property
    def id(self) -> str:
        return "average"

    def init(self, frame):
        return History.of(frame.color[0])

    def step(self, state, frame, motion):
        past = state.at(frame.displacement(motion.increment))
        shown = past + self.share * (frame.color[0] - past)
        return History.of(shown), shown


class Blur(hj.techniques.AbstractTechnique):
    """Mean of a pixel and its neighbours, without a word of how far they are."""

    radius: int = eqx.field(static=True, default=1)

    @property
    def id(self):
        return "blur"

    def init(self, frame):
        return None

    def step(self, state, frame, motion) -> Any:
        r = self.radius
        planes = jnp.pad(frame.color[0], [(0, 0), (r, r), (r, r)], mode="edge")
        _, height, width = frame.color[0].shape
        near = [
            planes[:, i : i + height, j : j + width]
            for i in range(2 * r + 1)
            for j in range(2 * r + 1)
        ]
        return None, sum(near) / len(near)


class BlurredAverage(Average):
    """Both, without a word of either."""

    @property
    def id(self):
        return "blurred"

    def step(self, state, frame, motion):
        _, blurred = Blur().step(None, frame, motion)
        past = state.at(frame.displacement(motion.increment))
        shown = past + self.share * (blurred - past)
        return History.of(shown), shown


class Forgetful(Average):
    """Says that little of an error remains, which is not so."""

    def history_gain(self, speed_deg_s):
        return 0.1 * np.ones_like(speed_deg_s)


class NearSighted(Blur):
    """Says that it reads no neighbour, which is not so."""

    @property
    def stencil_radius_px(self):
        return 0


class Sham(Average):
    """Says that it shows pictures as they are, which is not so."""

    def on_pictures(self):
        return NoAntialiasing()


def study(measure, *techniques, sessions=SESSIONS):
    chosen = (NoAntialiasing(), *techniques)
    return small.study(techniques=chosen, measure=measure, sessions=sessions).run(3)


@pytest.fixture(scope="module")
def whole():
    return study(WholeFrame(), Average(), Blur(), HeadMovement())


@pytest.fixture(scope="module")
def tiles():
    return study(Tiles(2, 16), Average(), Blur(), HeadMovement())


@pytest.mark.slow
@pytest.mark.parametrize("metric", ["mtcd", "detail_loss"])
def test_tiles_have_the_mean_of_whole_frames(whole, tiles, metric):
    difference = tiles[metric].values - whole[metric].values
    mean, error = difference.mean(-1), difference.std(-1, ddof=1) / SESSIONS**0.5
    # Eight numbers, each beyond 4 standard errors once in 10^4 (Student, 47 degrees).
    assert (np.abs(mean) < 4 * error).all()
    assert (error < 0.1 * whole[metric].values.mean(-1)).all()


def test_all_tiles_together_are_the_whole_frame():
    # Nothing is left to chance: each cell of the grid is drawn once.
    both = (WholeFrame(), Tiles(16, 16))
    whole, every = (study(m, BlurredAverage(), sessions=1) for m in both)
    for metric in ("mtcd", "detail_loss"):
        np.testing.assert_allclose(every[metric], whole[metric], rtol=1e-4)
    # One's own is compared in the same study.
    mtcd = whole["mtcd"].sel(scene="noise").mean("session")
    assert 0 < mtcd.sel(technique="blurred") < mtcd.sel(technique="none")


@pytest.mark.parametrize(
    ("technique", "hint"),
    [
        (Forgetful(), "history_gain of average must be at least 0.8"),
        (NearSighted(), "stencil_radius_px of blur must be at least 1"),
        (Sham(), "on_pictures of average must show the same"),
    ],
)
def test_a_wrong_hint_is_an_error(technique, hint):
    if isinstance(technique, Blur):  # both look at hints alike: here the quickest
        with pytest.raises(ValueError, match=hint):
            check(technique)
    with pytest.raises(ValueError, match=hint):
        hj.Study(
            scenes={"noise": hj.scenes.power_law_noise()},
            techniques=(technique,),
            baseline=technique.id,
            head=HEAD,
            camera=CAMERA,
            measure=Tiles(2, 16),
        ).run(0)


@pytest.mark.parametrize("radius", [1, 3])
def test_a_stencil_is_found(radius):
    from hmdjit.technique_contract.stencil import stencil_radius_px

    assert stencil_radius_px(Blur(radius)) == radius
    assert stencil_radius_px(Average()) == 0


class Jittered(NoAntialiasing):
    """Shows each of four places of a pixel in turn."""

    @property
    def id(self):
        return "jittered"

    @property
    def sample_offsets_px(self):
        return ordered_grid(2)[:, None]


@pytest.mark.slow
def test_samples_over_time_and_within_a_frame_are_not_taken_for_each_other():
    techniques = (Jittered(), hj.techniques.SSAA(2))  # tables of the same numbers
    together = small.study(techniques=techniques, baseline="jittered").run(0)
    for technique in techniques:
        alone = small.study(techniques=[technique], baseline=technique.id).run(0)
        ours = together["mtcd"].sel(technique=[technique.id])
        np.testing.assert_allclose(ours, alone["mtcd"], rtol=1e-6)


def test_a_technique_that_needs_more_than_a_scene_gives_is_refused():
    class Deep(Average):
        @property
        def needs(self):
            return frozenset({"color", "depth"})

    class Flat(hj.scenes.AbstractFlatScene):
        name: str = eqx.field(static=True, default="flat")

        @property
        def gives(self):
            return frozenset({"color", "supersampled"})

        def plane_color(self, camera, x, y):
            return jnp.zeros((3, *x.shape), x.dtype)

    message = "average needs depth, which noise does not give"
    with pytest.raises(ValueError, match=message):
        hj.Study(
            scenes={"noise": Flat()},
            techniques=(Deep(),),
            baseline="average",
            head=HEAD,
        )
    with pytest.raises(ValueError, match="average needs depth, which this scene"):
        hj.simulate(Flat(), CAMERA, Deep(), small.STILL)


@pytest.mark.parametrize(
    "id", ["none", "freeze", "msaa4", "ssaa2", "ssaa4", "head_movement"]
)
def test_the_package_s_own_pass(id):
    check(hj.techniques.by_id(id))
