"""Sessions and studies of solids, alone and beside pictures."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.estimates.summary import summarize
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.neck import NeckModel
from hmdjit.frames.sources import History
from hmdjit.scenes.shapes import Movement
from hmdjit.simulation.session import fastest_reading
from hmdjit.studies import identity
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.studies.store import fingerprint
from hmdjit.technique_contract.base import AbstractTechnique
from hmdjit.techniques import MSAA, NoAntialiasing

CAMERA = small.CAMERA_8_PX_PER_DEG
HEAD = hj.HeadMotion.fixating()
SOLIDS = small.solids()
FRAMES, WARMUP = 4, 2


class Following(AbstractTechnique):
    """Exponential average along the content's own motion."""

    share: float = 0.3

    version = "1"

    @property
    def id(self):
        return "following"

    @property
    def needs(self):
        return frozenset({"color", "velocity"})

    @property
    def stencil_radius_px(self):
        return 0

    def init(self, frame):
        return History.of(frame.color[0])

    def step(self, state, frame, motion):
        past = state.at(frame.reprojection(motion))
        shown = past + self.share * (frame.color[0] - past)
        return History.of(shown), shown


def study(**changes):
    settings = {
        "scenes": {"noise": small.NOISE, "solids": SOLIDS},
        "techniques": (NoAntialiasing(), MSAA(4)),
        "head": HEAD,
        "camera": CAMERA,
        "frames": FRAMES,
        "warmup": WARMUP,
        "sessions": 6,
        "measure": Tiles(1, 16),
    }
    return small.study(**(settings | changes))


@pytest.fixture(scope="module")
def poses():
    return np.asarray(HEAD.sample(jax.random.key(0), 60.0, WARMUP + FRAMES))


@pytest.fixture(scope="module")
def data():
    return study().run(3, batch_size=2)


def simulated(poses, scene: hj.scenes.AbstractScene = SOLIDS, warmup=WARMUP, **options):
    return hj.simulate(
        scene, CAMERA, NoAntialiasing(), poses, warmup=warmup, **options
    ).metrics


def with_places(poses, places):
    return np.concatenate([poses, np.broadcast_to(places, (len(poses), 3))], axis=1)


# --- one session ---


def test_a_head_turns_on_its_neck_unless_its_place_is_known(poses):
    on_neck, off = simulated(poses), simulated(poses, neck=None)
    assert on_neck["mtcd"] != off["mtcd"]
    # A place that never changes is a head that turns about its eye.
    assert simulated(with_places(poses, 0.5))["mtcd"] == pytest.approx(off["mtcd"])
    moved = with_places(poses, 0.0)
    moved[:, 4] = 1e-3 * np.arange(len(poses))
    assert simulated(moved)["mtcd"] == simulated(moved, neck=None)["mtcd"]


def of_a_picture(poses, warmup=WARMUP, reading=GATHER, **options):
    texture = small.texture(np.random.default_rng(1))
    found = hj.simulate(
        texture,
        small.CAMERA,
        NoAntialiasing(),
        poses,
        warmup=warmup,
        reading=reading,  # what compiles soonest
        **options,
    )
    return {name: float(value) for name, value in found.metrics.items()}


def test_a_picture_knows_no_place():
    poses = small.path(np.random.default_rng(0), 8)
    known = with_places(poses, 0.0)
    known[:, 4:] = np.arange(len(poses))[:, None]
    usual, other = (
        of_a_picture(path, neck=neck)
        for path, neck in ((poses, NeckModel()), (known, NeckModel(up_m=0.5)))
    )
    assert usual == other


def reference_of_every_other_frame(run, reading):
    """The frames of even number and the others, together, are all of them."""
    usual = run(warmup=WARMUP, reading=reading)
    reading = dataclasses.replace(reading, reference_every=2)
    even = run(warmup=WARMUP, reading=reading)
    odd = run(warmup=WARMUP + 1, reading=reading)
    assert even["mtcd"] == usual["mtcd"]
    mean = (even["detail_loss"] + odd["detail_loss"]) / 2
    np.testing.assert_allclose(mean, usual["detail_loss"], rtol=1e-5)
    assert even["detail_loss"] != odd["detail_loss"]


def test_the_reference_is_held_against_every_other_frame():
    poses = small.path(np.random.default_rng(0), WARMUP + FRAMES)
    reference_of_every_other_frame(
        lambda **options: of_a_picture(poses, **options), GATHER
    )


@pytest.mark.slow
def test_solids_are_held_against_every_other_frame(poses):
    reference_of_every_other_frame(
        lambda **options: simulated(poses, **options), fastest_reading()
    )


# --- studies ---


def test_pictures_and_solids_in_one_study(data):
    picture, solid = (data["mtcd"].sel(scene=name) for name in ("noise", "solids"))
    np.testing.assert_array_equal(
        picture.sel(technique="msaa4"), picture.sel(technique="none")
    )
    assert (solid.sel(technique="msaa4") != solid.sel(technique="none")).any()
    assert np.isfinite(data["mtcd"].values).all()
    said = "Solids (solids): neck 0.075 m up, 0.0805 m forward; detail loss to 16 rays"
    assert said in identity.footer(data)


def test_a_picture_gives_the_same_beside_solids(data):
    alone = study(scenes={"noise": small.NOISE}).run(3, batch_size=2)
    np.testing.assert_array_equal(
        alone["mtcd"].sel(scene="noise"), data["mtcd"].sel(scene="noise")
    )


def test_batches_are_found_again(tmp_path, data):
    study(sessions=4).run(3, out=tmp_path, batch_size=2)
    events = []
    again = study().run(3, out=tmp_path, batch_size=2, progress=events.append)
    assert max(event.fresh for event in events) == 8  # 2 sessions x 2 x 2
    for name in ("mtcd", "detail_loss"):
        np.testing.assert_array_equal(again[name], data[name])


def test_all_that_is_in_a_scene_counts():
    others = [
        small.solids(movement=None),
        small.solids(movement=Movement(velocity_m_s=(0.35, 0.1, 1e-6))),
        dataclasses.replace(SOLIDS, has_sun=True),
        dataclasses.replace(SOLIDS, ambient=np.asarray(0.2)),
    ]
    found = {fingerprint(scene) for scene in [SOLIDS, *others]}
    assert len(found) == len(others) + 1
    assert fingerprint(SOLIDS) == fingerprint(small.solids())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"neck": 3}, "neck must be a NeckModel or None"),
        ({"reference_samples": 0}, "reference_samples must"),
        ({"reference_every": 0}, "reference_every must"),
    ],
)
def test_wrong_numbers_are_refused(change, message, untyped):
    with pytest.raises(ValueError, match=message):
        study(**change)


@pytest.mark.slow
def test_a_goal_takes_more_of_solids_than_of_pictures():
    found = study(techniques=(NoAntialiasing(),)).run(3, tolerance=0.1)
    noise, solids = json.loads(found.attrs["plan"])
    assert noise["estimator"] == "control variate"
    assert solids["estimator"] == "simulation"
    assert "without a control variate" in solids["why"]
    for row in summarize(found):
        if row.scene == "solids":
            assert row.high - row.low <= 2 * 0.1 * row.mean


# --- halos of what follows things that move ---


def follow(measure, sessions):
    return study(
        scenes={"solids": SOLIDS},
        techniques=(Following(),),
        baseline="following",
        measure=measure,
        sessions=sessions,
    ).run(5)


def unlike_the_whole(sessions=4):
    """How far all tiles together are from the whole frame, in each session."""
    whole, tiles = (follow(m, sessions) for m in (WholeFrame(), Tiles(16, 16)))
    # Nothing is left to chance: each cell of the grid is drawn once.
    return np.abs(tiles["mtcd"].values - whole["mtcd"].values).ravel()


@pytest.mark.slow
def test_all_tiles_together_are_the_whole_frame_where_things_move(monkeypatch):
    # Errors beyond a halo reach tiles with less than 1e-5 of the colour range; MTCD
    # moves by at most 2 x 255 x sqrt(3) times that.
    assert unlike_the_whole().max() < 9e-3
    narrow = lambda scene, view: jnp.zeros((2, 2), view.motion.offset.dtype)
    monkeypatch.setattr(type(SOLIDS), "velocity_bounds", narrow)
    jax.clear_caches()
    assert unlike_the_whole().max() > 0.1
