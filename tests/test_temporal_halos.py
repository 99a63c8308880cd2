"""Tiles of temporal techniques: what lies beyond a halo does not reach them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.frames.sources import AbstractSource
from hmdjit.simulation.halo import HALO_TOLERANCE, needed_halo_px
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.technique_contract.base import AbstractTemporal

SIDE, TILE, FRAMES = 80, 16, 6
START = (SIDE - TILE) // 2
CAMERA = hj.Camera(SIDE, SIDE, fov_deg=16.0)
TEMPORAL = [
    technique
    for technique in map(hj.techniques.by_id, hj.techniques.IDS)
    if isinstance(technique, AbstractTemporal)
]
DEFAULTS = [t for t in TEMPORAL if t == type(t)()]
MOST_PX = 1.2  # that things move per frame


class Moving(AbstractSource):
    """Says how fast its things move, and no more."""

    @property
    def gives(self):
        return frozenset({"color"})

    def seen(self, view, samples_px, channels):
        raise AssertionError("nothing is rendered here")

    def reference(self, view):
        raise AssertionError("nothing is rendered here")

    def covers(self, camera, region, motion):
        raise AssertionError("nothing is rendered here")

    def velocity_bounds(self, view):
        return jnp.asarray([[-MOST_PX] * 2, [MOST_PX] * 2], view.motion.offset.dtype)


@pytest.fixture(scope="module")
def clip():
    """Frames of a noisy picture, and channels that say it stands or moves."""
    rng = np.random.default_rng(5)
    picture = rng.random((SIDE, SIDE, 3))
    # What stays between the frames is kept by clips to what is around a pixel.
    color = 0.8 * picture + 0.2 * rng.random((FRAMES, SIDE, SIDE, 3))
    turns = rng.normal(0, 0.5, (FRAMES - 1, 3)) / CAMERA.focal_px
    one = np.ones((FRAMES, SIDE, SIDE))
    pictures = {"depth": np.inf * one, "object_id": 0 * one, "albedo": color}
    ids = np.broadcast_to(rng.integers(0, 2, (SIDE, SIDE)), one.shape)
    solids = {"depth": 1.0 + ids, "object_id": ids, "albedo": color}
    speeds = rng.uniform(-MOST_PX, MOST_PX, (FRAMES, 2, 2))
    solids["velocity_px"] = speeds[np.arange(FRAMES)[:, None, None], ids]
    still = {"motion_class": 0 * one}
    poses = small.viewing.oracles.poses_after(turns)
    return poses, color, {"picture": pictures | still, "solids": solids | still}


def shown(technique, poses, color, channels):
    needs = {"velocity_px" if n == "velocity" else n for n in technique.needs}
    read = {name: planes for name, planes in channels.items() if name in needs}
    return np.asarray(hj.apply(technique, CAMERA, color, poses, **read))


@pytest.mark.parametrize(
    "scene", [pytest.param("picture", marks=pytest.mark.slow), "solids"]
)
@pytest.mark.parametrize("technique", TEMPORAL, ids=lambda technique: technique.id)
def test_what_lies_beyond_the_halo_does_not_reach_the_tile(clip, technique, scene):
    poses, color, channels = clip
    motion = jax.tree.map(lambda leaf: leaf[None], hj.Motion.of(jnp.asarray(poses)))
    origin = np.full((1, 1, 2), START, np.int32)
    source = None if scene == "picture" else Moving()
    (halo,) = needed_halo_px(technique, CAMERA, motion, origin, (TILE, TILE), source)
    low, high = START - halo, START + TILE + halo
    assert low > 0  # something is left beyond it

    def changed(planes):
        others = np.asarray(planes)[:, ::-1, ::-1].copy()
        others[:, low:high, low:high] = planes[:, low:high, low:high]
        return others

    usual = shown(technique, poses, color, channels[scene])
    others = {name: changed(planes) for name, planes in channels[scene].items()}
    unlike = shown(technique, poses, changed(color), others)
    difference = np.abs(usual - unlike).max(axis=(0, 3))
    tile = slice(START, START + TILE)
    assert difference[tile, tile].max() < HALO_TOLERANCE
    halo = slice(low, high)
    # The bound is not empty. (Two frames of a picture are not mixed at such speeds.)
    is_mixed = technique.id != "two_frame" or scene == "solids"
    assert not is_mixed or difference[halo, halo].max() > HALO_TOLERANCE


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["noise", "solids"])
def test_a_study_by_tiles_is_that_of_the_whole_frame(scene):
    scenes = {"noise": small.NOISE, "solids": small.solids(movement=None)}
    # All 16 tiles: their mean is that of the frame.
    tiles, whole = (
        small.study(
            scenes={scene: scenes[scene]},
            techniques=[hj.techniques.NoAntialiasing(), *DEFAULTS],
            measure=measure,
            sessions=2,
        ).run(0)["mtcd"]
        for measure in (Tiles(16, 16), WholeFrame())
    )
    np.testing.assert_allclose(tiles, whole, rtol=1e-4)
