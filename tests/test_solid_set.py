import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

from hmdjit import scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.motion import Motion
from hmdjit.frames.sources import View
from hmdjit.scenes.primitives import Capsules, Quads, Spheres
from hmdjit.scenes.solids import Solids

SIDE = 32
CAMERA = Camera(SIDE, SIDE, fov_deg=96.0, refresh_hz=60.0)
NAMES = (
    *("fence", "hut", "pipe", "blinds", "arched_window", "wall_text", "atrium"),
    *("flowers", "hairball", "hairball_shadow", "moving_sphere"),
)
MOVING = {"fence", "hut", "moving_sphere"}
AHEAD_M = {  # how far away what lies straight ahead is
    "fence": (2.4, 100),  # between its wires a hill
    "hut": (3, 5.6),
    "pipe": (2, 3),
    "blinds": (1.4, 100),
    "arched_window": (1.5, 1.7),
    "wall_text": (2, 2.5),
    "atrium": (16.7, 16.9),
    "flowers": (1.4, 1.7),
    "hairball": (0.6, 1.9),
    "hairball_shadow": (0.6, 1.9),
    "moving_sphere": (16.7, 16.9),
}
MOST = {Quads: 600, Capsules: 2400, Spheres: 16}
OBJECTS = 8


@pytest.fixture(scope="module")
def solid_set():
    return scenes.solid_set()


@pytest.fixture(scope="module")
def places(solid_set):
    """Depth, object and motion class of all scenes by one program: at frames 0, 20."""
    look = small.quickly(_places)
    alike = {name: _alike(solid_set[name], solid_set["hut"]) for name in NAMES}
    return {
        name: [jax.tree.map(np.asarray, look(scene, jnp.int32(f))) for f in (0, 20)]
        for name, scene in alike.items()
    }


def _view(frame):
    still = Motion(jnp.zeros(3, jnp.float32), jnp.zeros(3, jnp.float32))
    return View(CAMERA, Region.whole(CAMERA), still, frame)


def _places(scene, frame):
    channels = {"depth", "object_id", "motion_class"}
    found = scene.seen(_view(frame), np.zeros((1, 2)), channels)
    return {name: planes[0, 0] for name, planes in found.items()}


def _alike(scene, other):
    """Bring a scene to the structure of all: rows again, unseen ones, no colours."""
    known = {type(table.rows): table for table in scene.tables}
    tables = []
    for table in other.tables:
        kind = type(table.rows)
        far = np.array([0, 0, 1e4])
        hidden = eqx.tree_at(lambda t: t.rows.centre, table, table.rows.centre + far)
        rows = known.get(kind, hidden)
        again = np.arange(MOST[kind]) % rows.count
        tables.append(jax.tree.map(lambda leaf, again=again: leaf[again], rows))
    more = lambda leaf: np.resize(
        np.concatenate([leaf, np.zeros((OBJECTS, *leaf.shape[1:]), leaf.dtype)]),
        (OBJECTS, *leaf.shape[1:]),
    )
    masks = np.ones((5, 96, 96), bool)
    if scene.masks is not None:
        count, high, wide = scene.masks.shape
        rows, columns = (np.arange(96) * side // 96 for side in (high, wide))
        masks[:count] = scene.masks[:, rows[:, None], columns[None]]
    return dataclasses.replace(
        scene,
        tables=tuple(tables),
        paths=jax.tree.map(more, scene.paths),
        classes=more(scene.classes),
        masks=masks,
        pictures=(),
        kinds=(0,),
        has_sun=False,
        has_shadows=False,
        moves=True,
        name="",
    )


def test_scenes_are_under_their_names_in_order(solid_set):
    assert tuple(solid_set) == (*NAMES, "honeycomb", "checkerboard")
    assert all(scene.name == name for name, scene in solid_set.items())
    assert all(isinstance(solid_set[name], Solids) for name in NAMES)


def test_a_scene_has_what_it_is_named_after(solid_set):
    for name in ("hairball", "hairball_shadow"):
        (hairs,) = solid_set[name].tables
        assert isinstance(hairs.rows, Capsules)
        assert hairs.count >= 2000
    assert not solid_set["hairball_shadow"].has_sun
    assert len(solid_set["flowers"].masks) == 5
    assert len(solid_set["wall_text"].pictures) == 1
    assert solid_set["atrium"].has_shadows
    assert {name for name in NAMES if solid_set[name].moves} == MOVING
    for name in MOVING:
        assert 1 in solid_set[name].classes


@pytest.mark.parametrize("name", NAMES)
def test_depths_are_those_of_what_is_there(name, places):
    depth = places[name][0]["depth"]
    middle = depth[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1]
    low, high = AHEAD_M[name]
    assert low < middle.min() < high
    assert 0.5 < depth.min() < 1.5  # the ground at the lower edge, or a hair


@pytest.mark.parametrize("name", NAMES)
def test_objects_are_told_apart(name, places, solid_set):
    start = places[name][0]
    ids, classes = start["object_id"], start["motion_class"]
    assert set(np.unique(ids)) <= set(range(len(solid_set[name].classes)))
    # The first object always shows, and so do those that move.
    moving = {n for n, kind in enumerate(solid_set[name].classes) if kind}
    assert {1, *moving} <= set(np.unique(ids))
    assert np.array_equal(classes, solid_set[name].classes[ids])
    assert np.array_equal(ids == 0, np.isinf(start["depth"]))


@pytest.mark.parametrize("name", NAMES)
def test_only_what_moves_changes(name, places):
    start, later = places[name]
    changed = [not np.array_equal(start[key], later[key]) for key in start]
    assert any(changed) == (name in MOVING)


def test_the_fence_comes_nearer_by_its_speed(places):
    start, later = (np.min(p["depth"][p["object_id"] == 2]) for p in places["fence"])
    assert start - later == pytest.approx(20 / 60, abs=0.01)


COLORED = [
    pytest.param(
        n, marks=[] if n in ("wall_text", "hairball_shadow") else pytest.mark.slow
    )
    for n in NAMES
]


@pytest.mark.parametrize("name", COLORED)
def test_colours_are_known_and_many(name, solid_set):
    look = lambda scene: scene.seen(_view(0), np.zeros((1, 2)), {"color"})["color"]
    color = np.asarray(small.quickly(look)(solid_set[name]))
    assert color.shape == (1, 3, SIDE, SIDE)
    assert color.min() >= 0
    assert color.max() <= 1
    assert color.std() > 0.05


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("fence", {"gap_m": 0.0}, r"gap_m must lie in \[0.05, 1\], got 0"),
        ("fence", {"bar_m": 0.2}, r"bar_m must lie in \(0, 0.2\), got 0.2"),
        ("fence", {"distance_m": -1.0}, "distance_m must lie in"),
        ("fence", {"speed_m_s": float("nan")}, "speed_m_s must lie in"),
        ("hut", {"rate_rad_s": float("inf")}, "rate_rad_s must lie in"),
        ("pipe", {"inclinations_deg": ()}, "at least one angle"),
        ("pipe", {"inclinations_deg": (0.0, 100.0)}, "inclinations_deg must lie in"),
        ("pipe", {"radius_m": 0.0}, "radius_m must lie in"),
        ("blinds", {"slats": 0}, "slats must be"),
        ("blinds", {"tilt_deg": 91.0}, "tilt_deg must lie in"),
        ("blinds", {"slat_m": 0.0}, "slat_m must lie in"),
        ("arched_window", {"bars": 0}, "bars must be"),
        ("arched_window", {"bar_m": -0.1}, "bar_m must lie in"),
        ("wall_text", {"line_m": 1.0}, "line_m must lie in"),
        ("wall_text", {"angle_deg": 90.0}, "angle_deg must lie in"),
        ("atrium", {"columns": 1}, "columns must be"),
        ("moving_sphere", {"radius_m": 2.0}, "radius_m must lie in"),
        ("flowers", {"count": 0}, "count must be"),
        ("flowers", {"size_m": 0.0}, "size_m must lie in"),
        ("hairball", {"hairs": 0}, "hairs must be"),
        ("hairball_shadow", {"hair_m": 0.0}, "hair_m must lie in"),
        ("hairball", {"seed": -1}, "seed must be"),
    ],
)
def test_parameters_are_checked(name, options, message):
    with pytest.raises(ValueError, match=message):
        getattr(scenes, name)(**options)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_have_defaults_and_a_name(name):
    parameters = inspect.signature(getattr(scenes, name)).parameters
    assert parameters["name"].default == name
    assert all(p.default is not p.empty for p in parameters.values())


def test_parameters_change_what_is_there():
    count = lambda scene: sum(table.count for table in scene.tables)
    assert count(scenes.fence(gap_m=0.1)) > count(scenes.fence())
    assert len(scenes.pipe((0.0, 10.0, 20.0)).classes) == 5
    assert count(scenes.blinds(slats=10)) == count(scenes.blinds()) - 30 * 6
    assert scenes.hairball(hairs=2).tables[0].object.size == 6
    one, other = (scenes.hairball(hairs=2, seed=s).tables[0].rows for s in (0, 1))
    assert not np.array_equal(one.centre, other.centre)
