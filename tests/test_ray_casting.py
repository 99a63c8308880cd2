"""What rays meet: hits, edges, depth, identity, motion, coverage and shadows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import ray_oracle
from scipy.spatial.transform import Rotation
from small import quickly

import hmdjit as hj
from hmdjit import rendering
from hmdjit.frames.displacement import Reading
from hmdjit.frames.neck import NeckModel
from hmdjit.scenes import primitives, shapes, surfaces
from hmdjit.scenes.shapes import Movement, Object, Sun
from hmdjit.scenes.solids import Solids
from hmdjit.techniques import MSAA, SSAA

RED, WHITE, GREY = (0.8, 0.1, 0.1), (1.0, 1.0, 1.0), (0.4, 0.4, 0.4)
CAMERA = hj.Camera(96, 80, fov_deg=70.0, refresh_hz=60.0)
WHOLE = hj.Region.whole(CAMERA)
FRAME = 7
CENTRE = np.zeros((1, 2))
GREY_PAINT = surfaces.uniform(GREY)


@pytest.fixture(scope="module")
def petals():
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    return np.hypot(x, y) < 0.6 + 0.35 * np.cos(5 * np.arctan2(y, x))


@pytest.fixture(scope="module")
def scene(petals):
    """Every kind of primitive, surface and movement."""
    fields = surfaces.checkerboard(WHITE, GREY, 0.4)
    spin = Movement((0.6, 0.1, 0.3), (0.2, 1.5, -0.4), (0.5, 0.0, -3.0))
    things = [
        Object(shapes.plane((0, -1.2, 0), (1, 0, 0), (0, 0, -1), fields)),
        Object(
            [
                *shapes.box((-0.9, -0.3, -3), (0.5, 0.9, 0.4), surfaces.uniform(RED)),
                *shapes.cylinder((-1.8, -1, -4), (-1.5, 1, -4.4), 0.2, fields),
            ]
        ),
        Object(shapes.sphere((0.6, 0.1, -3), 0.4, fields), spin),
        Object(
            [
                *shapes.capsule(
                    (0.2, 0.7, -2.6), (1.4, 0.9, -3.4), 0.12, surfaces.uniform(WHITE)
                ),
                *shapes.box((1.2, -0.6, -3.2), (0.5, 0.4, 0.5), fields, (0.3, 0.5, 0)),
            ],
            Movement((-0.5, 0.2, 0.0), motion_class="deforming"),
        ),
        Object(
            [
                *shapes.rectangle(
                    (-0.2, 0.8, -2.5),
                    (0.8, 0, 0.2),
                    (0, 0.8, 0),
                    surfaces.uniform(RED).cut_out(petals),
                ),
                *shapes.disc((0.1, -0.5, -2), (0.5, 0, 0), (0, 0.3, 0.1), fields),
            ]
        ),
    ]
    return Solids.of(things, sun=Sun(has_shadows=True))


MOVED = NeckModel().moved(
    hj.Motion(jnp.array([[0.06, -0.09, 0.04]]), jnp.array([[0.01, 0.02, -0.015]]))
)
NOW = jax.tree.map(lambda leaf: leaf[0], MOVED)


@quickly
def rendered(scene, motion):
    names = {"color", "depth", "object_id", "motion_class", "velocity", "coverage"}
    return rendering.render(
        scene, CAMERA, WHOLE, motion, CENTRE, frame=FRAME, channels=names
    )


@pytest.fixture(scope="module", params=["float32", "float64"])
def frame(request, scene):
    """A frame by a turned head on a neck, in both precisions."""
    return rendered(scene, jax.tree.map(lambda x: x.astype(request.param), NOW))


@pytest.fixture(scope="module")
def truth(scene):
    """Depth and surface where the oracle sees them: at centres and close to them."""

    def at(dx, dy):
        x, y = ray_oracle.pixels(CAMERA)
        pose = np.array(NOW.offset), x + dx, y + dy, np.array(NOW.position_m)
        return ray_oracle.seen(scene, CAMERA, *pose, time_s=FRAME / 60.0)

    e = 1e-3
    around = [at(dx, dy)[1] for dx in (-e, e) for dy in (-e, e)]
    depth, surface = at(0, 0)
    return depth, surface, np.all([each == surface for each in around], axis=0)


def test_every_pixel_sees_what_the_oracle_sees_but_at_edges(frame, truth, scene):
    _, surface, is_inside = truth
    assert is_inside.mean() > 0.98
    ours = np.asarray(frame.channels["coverage"][0, 0]) - 1
    np.testing.assert_array_equal(ours[is_inside], surface[is_inside])
    objects = np.concatenate([[0], *(table.object for table in scene.tables)])
    np.testing.assert_array_equal(
        np.asarray(frame.object_id)[is_inside], objects[surface + 1][is_inside]
    )
    classes = np.array([0, 0, 0, 1, 2, 0])[objects[surface + 1]]
    np.testing.assert_array_equal(
        np.asarray(frame.motion_class)[is_inside], classes[is_inside]
    )
    assert len(set(surface.ravel()) | {-1, 0}) == len(set(surface.ravel())) > 10


def test_depth_is_that_of_the_oracle(frame, truth):
    depth, _, is_inside = truth
    ours = np.asarray(frame.depth)
    # Near the horizon a ray meets the floor at 1e-3: eps counts a thousandfold.
    rtol = 1e-12 if ours.dtype == np.float64 else 1e-5
    is_near = is_inside & ~((depth > 100) & np.isfinite(depth))
    np.testing.assert_allclose(ours[is_near], depth[is_near], rtol=rtol)
    np.testing.assert_allclose(
        1 / ours[is_inside], 1 / depth[is_inside], atol=10 * rtol
    )
    assert np.isinf(ours[is_inside]).any()


def test_velocity_is_the_difference_of_projected_surface_points(frame, truth, scene):
    depth, surface, is_inside = truth
    x, y = ray_oracle.pixels(CAMERA)
    offset, position = np.array(NOW.offset), np.array(NOW.position_m)
    rays = ray_oracle.directions(CAMERA, offset, x, y)
    depth = np.where(np.isfinite(depth), depth, 1e9)
    point = position + depth[..., None] * rays
    objects = np.concatenate([[0], *(table.object for table in scene.tables)])
    number = objects[surface + 1]
    before = point.copy()
    now, then = FRAME / 60.0, (FRAME - 1) / 60.0
    for k in range(1, 6):
        turn, pivot, pace = (
            np.asarray(getattr(scene.paths, name))[k]
            for name in ("rotation", "pivot", "velocity")
        )
        own = (
            Rotation.from_rotvec(turn * now)
            .inv()
            .apply((point[number == k]) - pivot - pace * now)
        )
        again = Rotation.from_rotvec(turn * then).apply(own)
        before[number == k] = again + pivot + pace * then
    head = (
        Rotation.from_rotvec(offset)
        * Rotation.from_rotvec(np.array(NOW.increment)).inv()
    )
    eye = np.array([0, 0.075, -0.0805])
    seen = head.inv().apply((before - (head.apply(eye) - eye)).reshape(-1, 3))
    seen = seen.reshape(before.shape)
    focal = float(CAMERA.focal_px)
    old_x = CAMERA.width_px / 2 - focal * seen[..., 0] / seen[..., 2]
    old_y = CAMERA.height_px / 2 + focal * seen[..., 1] / seen[..., 2]
    expected = np.stack([x - old_x, y - old_y])
    ours = np.asarray(frame.channels["velocity"][0])
    atol = 1e-9 if ours.dtype == np.float64 else 1e-3
    far = np.broadcast_to(surface == -1, expected.shape)
    np.testing.assert_allclose(
        ours[:, is_inside & ~far[0]], expected[:, is_inside & ~far[0]], atol=atol
    )
    np.testing.assert_allclose(ours[far], expected[far], atol=1e-3)
    reprojected = frame.reprojection(NOW).px()
    np.testing.assert_array_equal(np.stack(reprojected), -ours)


def _single(row):
    """A row in float32."""
    single = lambda x: jnp.asarray(x, jnp.float32 if x.dtype == float else None)
    return jax.tree.map(single, row)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "rectangle", "disc"])
def test_hits_are_where_the_solid_begins(rng, kind):
    # By bisection of a signed distance along each ray: no formula of a root.
    surface = surfaces.uniform(GREY)
    start, end, radius = np.array([0.3, -0.2, -2.0]), np.array([-0.5, 0.4, -2.6]), 0.3
    right, up = np.array([1.1, 0.0, 0.4]), np.array([0.0, 0.9, 0.0])
    ((row, _), *_) = {
        "sphere": lambda: shapes.sphere(start, radius, surface),
        "capsule": lambda: shapes.capsule(start, end, radius, surface),
        "cylinder": lambda: shapes.cylinder(start, end, radius, surface),
        "rectangle": lambda: shapes.rectangle(start, right, up, surface),
        "disc": lambda: shapes.disc(start, right, up, surface),
    }[kind]()

    def distance(point):
        if kind == "sphere":
            return np.linalg.norm(point - start, axis=-1) - radius
        if kind in ("capsule", "cylinder"):
            axis = end - start
            share = (point - start) @ axis / (axis @ axis)
            inner = np.clip(share, 0, 1) if kind == "capsule" else share
            return (
                np.linalg.norm(point - start - inner[..., None] * axis, axis=-1)
                - radius
            )
        return (point - start) @ np.cross(right, up)

    origin = rng.normal(size=(4000, 3)) * 0.1
    direction = start + rng.normal(size=(4000, 3)) * 0.5 - origin
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    steps = np.linspace(0, 5, 2001)
    along = origin[:, None] + steps[:, None] * direction[:, None]
    sign = np.sign(distance(along))
    crossing = sign[:, 1:] * sign[:, :-1] <= 0
    first = np.argmax(crossing, axis=1)
    low, high = steps[first], steps[first + 1]
    for _ in range(40):
        middle = (low + high) / 2
        is_low = (
            np.sign(distance(origin + middle[:, None] * direction))
            == sign[np.arange(4000), first]
        )
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    expected = np.where(crossing.any(axis=1), (low + high) / 2, np.inf)
    met = origin + np.where(np.isfinite(expected), expected, 0)[:, None] * direction
    room = np.full(4000, np.inf)  # how far from an edge
    if kind == "cylinder":
        share = (met - start) @ (end - start) / np.sum((end - start) ** 2)
        room = np.minimum(share, 1 - share)
    elif kind in ("rectangle", "disc"):
        a, b = (2 * ((met - start) @ v) / (v @ v) for v in (right, up))
        room = 1 - (np.hypot(a, b) if kind == "disc" else np.maximum(abs(a), abs(b)))
    single = _single(row)
    planes = [tuple(jnp.asarray(v.T, jnp.float32)) for v in (origin, direction)]
    length, is_hit = jax.jit(type(row).hit)(single, *planes)
    ours = np.where(is_hit, length, np.inf)
    # Nearly along the surface no length is well known, as near an edge.
    gap = 1e-4
    slope = np.abs(
        distance(met + gap * direction) - distance(met - gap * direction)
    ) / (2 * gap)
    is_clear = (np.abs(room) > 1e-4) & (slope > 0.05)
    is_there = np.isfinite(expected) & (room > 0)
    clear_miss = ~np.isfinite(expected) & (np.abs(distance(along)).min(axis=1) > 1e-4)
    assert (is_there & is_clear).sum() > 500
    assert np.isinf(ours[clear_miss | (room < -1e-4)]).all()
    both = is_there & is_clear
    np.testing.assert_allclose(ours[both], expected[both], rtol=1e-5)


def test_a_cylinder_shows_its_near_end_and_its_far_end_never():
    tube = shapes.cylinder(
        (0.0, 0.0, -2.0), (0.0, 0.0, -3.0), 0.5, surfaces.uniform(RED)
    )
    frame = rendered(Solids.of([Object(tube)]), NOW.turning())
    assert 1.9 < np.asarray(frame.depth).min() < 2.1
    from_above = [(0, -2, -2), (0, -1, -2), 0.3, surfaces.uniform(RED)]
    still = hj.Motion(0 * NOW.offset, 0 * NOW.offset)
    frame = rendered(Solids.of([Object(shapes.cylinder(*from_above))]), still)
    depth = np.asarray(frame.depth)
    # The lid, 1 m below the eye, begins nearer than 1.8 m and ends farther than 2.2 m.
    row, column = np.nonzero(np.isfinite(depth))
    y = (row + 0.5 - CAMERA.height_px / 2) / float(CAMERA.focal_px)
    on_lid = np.abs(depth[row, column] * y - 1) < 1e-6
    np.testing.assert_allclose(np.ptp(depth[row, column][on_lid]), 0.6, atol=0.1)


@pytest.mark.parametrize("shape", [shapes.box, shapes.cylinder])
def test_what_is_seen_from_outside_faces_outwards(shape):
    first = (0.2, -0.1, -3.0)
    made = {
        shapes.box: lambda: shape(first, (1.0, 2.0, 0.5), GREY_PAINT, (0.3, -0.8, 0.4)),
        shapes.cylinder: lambda: shape(first, (0.5, 0.6, -2.0), 0.2, GREY_PAINT),
    }[shape]
    middle = np.array(first) if shape is shapes.box else np.array([0.35, 0.25, -2.5])
    sides = [p.primitive for p in made() if isinstance(p.primitive, primitives.Quads)]
    assert len(sides) == (6 if shape is shapes.box else 2)
    for side in sides:
        assert np.cross(side.right, side.up) @ (side.centre - middle) > 0


def test_a_capsule_is_met_along_its_axis_and_casts_a_shadow_there():
    pill = shapes.capsule(
        (0.0, 0.0, -3.0), (0.0, 0.5, -3.0), 0.4, surfaces.uniform(RED)
    )
    floor = shapes.plane((0, -1, 0), (1, 0, 0), (0, 0, -1), surfaces.uniform(WHITE))
    camera, still = (
        hj.Camera(33, 33, fov_deg=70.0),
        hj.Motion(jnp.zeros(3), jnp.zeros(3)),
    )
    dark = []
    for sun in ((0.0, 1.0, 0.0), (1e-4, 1.0, 0.0)):
        solid = Solids.of([Object([*floor, *pill])], sun=Sun(sun, has_shadows=True))
        frame = rendering.render(solid, camera, hj.Region.whole(camera), still, CENTRE)
        dark.append(int((np.abs(frame.color[0] - frame.color[0].min()) < 0.2).sum()))
    assert dark[0] == dark[1] > 0
    along = shapes.capsule(
        (0.0, 0.0, -2.0), (0.0, 0.0, -3.0), 0.5, surfaces.uniform(RED)
    )
    row = _single(along[0].primitive)
    zero, ahead = (
        (jnp.float32(0),) * 3,
        (jnp.float32(0), jnp.float32(0), jnp.float32(-1)),
    )
    length, is_hit = row.hit(zero, ahead)
    assert is_hit
    np.testing.assert_allclose(length, 1.5, rtol=1e-6)


def test_a_surface_goes_on_beyond_the_horizon_as_it_is_lit():
    floor = shapes.plane((0, -1, 0), (1, 0, 0), (0, 0, -1), surfaces.uniform(GREY))
    solid = Solids.of([Object(floor)], sun=Sun((0.0, 1.0, 0.0)))
    camera = hj.Camera(33, 33, fov_deg=60.0)
    pitch = jnp.array([0.25 / float(camera.focal_px), 0.0, 0.0])
    now, table = hj.Motion(pitch, pitch), MSAA(4).sample_offsets_px[0]
    names, region = {"multisampled", "coverage"}, hj.Region.whole(camera)
    frame = rendering.render(solid, camera, region, now, table, channels=names)
    is_floor = np.asarray(frame.channels["coverage"][:, 0] > 0)
    np.testing.assert_allclose(np.asarray(frame.color[:, 0])[is_floor], 0.4, atol=1e-6)
    assert is_floor.any(axis=0).sum() > is_floor.all(axis=0).sum()  # a row of both


def test_a_thin_hair_far_away_is_as_wide_as_it_is():
    # 0.1 mm at 3 m: 0.01 px of a camera of 400 px per rad. By disciminants in float32
    # it would come and go.
    hair = shapes.capsule((-1, 0.1, -3), (1, -0.1, -3), 1e-4, surfaces.uniform(RED))
    row = _single(hair[0].primitive)
    slopes = np.linspace(-3e-4, 3e-4, 4001) / 3
    rays = (
        jnp.zeros(4001, jnp.float32),
        jnp.asarray(slopes, jnp.float32),
        jnp.float32(-1),
    )
    origin = (jnp.float32(0),) * 3
    _, is_hit = type(row).hit(row, origin, rays)
    width = np.ptp(slopes[np.asarray(is_hit)]) * 3
    np.testing.assert_allclose(width, 2e-4 / np.cos(np.arctan(0.1)), rtol=2e-3)


def half_plane(angle):
    """A wall whose edge passes the middle of the picture, under an angle."""
    out = np.array([np.cos(angle), np.sin(angle), 0])
    along = np.array([-np.sin(angle), np.cos(angle), 0])
    middle = np.array([0.001, 0.0007, -1.0]) + 50 * out
    return Solids.of(
        [
            Object(
                shapes.rectangle(
                    middle, 100 * out, 100 * along, surfaces.uniform(WHITE)
                )
            )
        ],
        sun=None,
        background=(0.0, 0.0, 0.0),
    )


@pytest.mark.parametrize("samples", [2, 4, 8, 16])
def test_coverage_of_a_half_plane_is_its_count_of_samples(samples):
    technique = MSAA(samples, space="gamma")
    table = technique.sample_offsets_px[0]
    camera = hj.Camera(12, 10, fov_deg=60.0)

    @quickly
    def counted(scene):
        still = hj.Motion(jnp.zeros(3), jnp.zeros(3))
        region = hj.Region.whole(camera)
        names = {"multisampled", "coverage"}
        frame = rendering.render(scene, camera, region, still, table, channels=names)
        return frame.channels["coverage"][:, 0].sum(axis=0), technique.resolve(frame)

    x, y = ray_oracle.pixels(camera)
    for angle in np.linspace(0, 2 * np.pi, 25)[:-1] + 0.01:
        count, shown = counted(half_plane(angle))
        rays = ray_oracle.directions(
            camera, np.zeros(3), x[..., None] + table[:, 0], y[..., None] + table[:, 1]
        )
        out = np.array([np.cos(angle), np.sin(angle)])
        expected = ((rays[..., :2] - [0.001, 0.0007]) @ out >= 0).sum(axis=-1)
        np.testing.assert_array_equal(count, expected)
        np.testing.assert_allclose(shown[0], expected / samples, atol=1e-12)


def test_inside_surfaces_msaa_shows_what_no_antialiasing_shows(scene):
    table = MSAA(4).sample_offsets_px[0]
    now = jax.tree.map(lambda x: x.astype("float32"), NOW)

    @quickly
    def both(scene):
        shots = [
            rendering.render(
                scene,
                CAMERA,
                WHOLE,
                now,
                where,
                frame=FRAME,
                channels={name, "coverage"},
            )
            for where, name in ((CENTRE, "color"), (table, "multisampled"))
        ]
        return (*shots, MSAA(4).resolve(shots[1]))

    plain, multi, shown = both(scene)
    covered = np.concatenate([plain.channels["coverage"], multi.channels["coverage"]])
    is_inside = (covered == covered[0]).all(axis=0)[0]
    assert 0.7 < is_inside.mean() < 0.99
    for sample in multi.color:
        np.testing.assert_array_equal(
            sample[:, is_inside], plain.color[0][:, is_inside]
        )
    np.testing.assert_allclose(
        shown[:, is_inside], plain.color[0][:, is_inside], atol=2e-6
    )
    # At edges it shows another picture, and textures alias on.
    assert np.abs(shown - plain.color[0])[:, ~is_inside].max() > 0.1


def test_a_wall_is_painted_as_its_surface_says(rng):
    picture = rng.random((6, 8, 3))
    walls = {
        "checkerboard": surfaces.checkerboard(WHITE, RED, 0.3),
        "stripes": surfaces.stripes(WHITE, RED, 0.2, 0.1),
        "picture": surfaces.picture(picture, 1.6),
    }
    camera = hj.Camera(40, 30, fov_deg=60.0)
    x, y = ray_oracle.pixels(camera)
    x, y = np.broadcast_arrays(
        (x - 20) / float(camera.focal_px) * 2 - 0.1,
        (15 - y) / float(camera.focal_px) * 2,
    )
    still = hj.Motion(jnp.zeros(3), jnp.zeros(3))
    for name, surface in walls.items():
        wall = shapes.plane((0.1, 0, -2), (1, 0, 0), (0, 1, 0), surface)
        solid = Solids.of([Object(wall)], sun=None)
        region = hj.Region.whole(camera)
        frame = rendering.render(solid, camera, region, still, CENTRE)
        ours = np.moveaxis(np.asarray(frame.color[0]), 0, -1)
        if name == "picture":
            column, row = (x / 1.6 + 0.5) * 8 - 0.5, (0.5 - y / 1.2) * 6 - 0.5
            j, i = np.floor(row).astype(int), np.floor(column).astype(int)
            v, u = (row - j)[..., None], (column - i)[..., None]
            at = lambda b, a: picture[b % 6, a % 8]
            top = at(j, i) * (1 - u) + at(j, i + 1) * u
            bottom = at(j + 1, i) * (1 - u) + at(j + 1, i + 1) * u
            expected = top * (1 - v) + bottom * v
        else:
            parity = (np.floor(x / 0.3) + np.floor(y / 0.3)) % 2
            is_first = parity == 0 if name == "checkerboard" else np.mod(y, 0.3) < 0.2
            expected = np.where(is_first[..., None], WHITE, RED)
        np.testing.assert_allclose(ours, expected, atol=1e-6)


def test_light_falls_off_with_the_angle_and_stops_in_shadow():
    ball, floor = surfaces.uniform(RED), surfaces.uniform(WHITE)
    things = [
        Object(shapes.plane((0, -1, 0), (1, 0, 0), (0, 0, -1), floor)),
        Object(shapes.sphere((0, 0.5, -4), 0.5, ball)),
    ]
    sun = np.array([0.3, 0.9, 0.2]) / np.linalg.norm([0.3, 0.9, 0.2])
    solid = Solids.of(things, sun=Sun(tuple(sun), 0.25, has_shadows=True))
    camera = hj.Camera(64, 64, fov_deg=70.0)
    still = hj.Motion(jnp.zeros(3), jnp.zeros(3))
    frame = rendering.render(solid, camera, hj.Region.whole(camera), still, CENTRE)
    ours = np.asarray(hj.metrics.image_error.color.decode(frame.color[0][0]))
    x, y = ray_oracle.pixels(camera)
    depth, surface = ray_oracle.seen(solid, camera, np.zeros(3), x, y)
    rays = ray_oracle.directions(camera, np.zeros(3), x, y)
    safe = np.where(np.isfinite(depth), depth, 0)[..., None]
    point = safe * rays
    away = np.array([0, 0.5, -4]) - point
    miss = np.linalg.norm(away - (away @ sun)[..., None] * sun, axis=-1)
    is_dark = (miss < 0.5) & (away @ sun > 0)
    is_sure = np.abs(miss - 0.5) > 1e-5
    on_floor = (surface == 0) & is_sure
    expected = np.where(is_dark, 0.25, 0.25 + 0.75 * sun[1])
    np.testing.assert_allclose(ours[on_floor], expected[on_floor], atol=1e-6)
    assert (on_floor & is_dark).sum() > 20
    normal = (point - [0, 0.5, -4]) / 0.5
    on_ball = surface == 1
    red = float(hj.metrics.image_error.color.decode(jnp.asarray(0.8)))
    expected = red * (0.25 + 0.75 * np.maximum(normal @ sun, 0))
    np.testing.assert_allclose(ours[on_ball], expected[on_ball], atol=1e-6)


def test_the_reference_is_the_mean_of_its_samples_in_linear_light(scene):
    now = jax.tree.map(lambda x: x.astype("float32"), NOW)
    region = hj.Region(30, 30, 24, 20)
    reading = Reading(reference_samples=8)
    reference = quickly(
        lambda s: rendering.reference(s, CAMERA, region, now, reading, frame=FRAME)
    )(scene)
    # Scrambled Halton: 2 and 3 mirrored, in base 3 with 1 and 2 exchanged.
    table = np.array(
        [
            [0, 1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8, 7 / 8],
            [0, 2 / 3, 1 / 3, 2 / 9, 8 / 9, 5 / 9, 1 / 9, 7 / 9],
        ]
    )
    each = quickly(
        lambda s, where: (
            rendering.render(s, CAMERA, region, now, where, frame=FRAME).color
        )
    )(scene, jnp.asarray(table.T - 0.5))
    decode, encode = (getattr(hj.scenes.baking.color, n) for n in ("decode", "encode"))
    np.testing.assert_allclose(
        reference, encode(jnp.mean(decode(each), axis=0)), atol=2e-6
    )


def test_a_region_is_the_same_in_blocks_and_alone(scene):
    now = jax.tree.map(lambda x: x.astype("float32"), NOW)
    camera = hj.Camera(200, 150, fov_deg=70.0)
    part = hj.Region(90, 50, 48, 40)
    render = lambda region: (
        rendering.render(
            scene, camera, region, now, SSAA(2).sample_offsets_px[0], frame=FRAME
        ).color
    )
    whole, alone = quickly(lambda: (render(hj.Region.whole(camera)), render(part)))()
    np.testing.assert_array_equal(whole[..., 50:90, 90:138], alone)


def test_all_primitives_give_the_same_as_those_that_can_be_met(scene):
    # Derivatives go through loops of a known length.
    now = jax.tree.map(lambda x: x.astype("float32"), NOW)
    region = hj.Region(20, 30, 32, 24)
    frames = [
        quickly(
            lambda s, reading: (
                rendering.render(
                    s, CAMERA, region, now, CENTRE, frame=FRAME, reading=reading
                ).color
            )
        )(scene, Reading(sampler))
        for sampler in ("slices", "plain")
    ]
    np.testing.assert_allclose(*frames, atol=1e-6)


def test_poses_that_do_not_move_are_those_that_turn(scene):
    still = hj.Motion(NOW.offset, NOW.increment, 0 * NOW.offset, 0 * NOW.offset)
    turning = hj.Motion(NOW.offset, NOW.increment)
    np.testing.assert_array_equal(
        rendered(scene, still).color, rendered(scene, turning).color
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: shapes.sphere((0, 0, -1), 0.0, s), "radius_m must lie in"),
        (
            lambda s: shapes.sphere((0, 0), 1.0, s),
            "centre must be three finite numbers",
        ),
        (
            lambda s: shapes.rectangle((0, 0, 0), (1, 0, 0), (1, 1, 0), s),
            "right and up must be at right angles",
        ),
        (
            lambda s: shapes.capsule((0, 0, 0), (0, 0, 0), 1.0, s),
            "length of axis, from start to end",
        ),
        (lambda s: Solids.of([]), "objects must have at least one shape, got none"),
        (lambda s: Sun((0.0, 0.0, 0.0)), "length of direction of a sun"),
        (
            lambda s: Solids.of(
                [Object(shapes.sphere((0, 0, -1), 0.1, s.cut_out([[True]])))]
            ),
            "mask of a surface must lie on a rectangle or an ellipse, got a round",
        ),
        (lambda s: Sun(ambient=1.5), "ambient must lie in"),
        (lambda s: Movement(motion_class="static"), "motion_class must be one of"),
        (lambda s: surfaces.uniform((255, 0, 0)), "first of a surface must lie in"),
    ],
)
def test_what_is_no_scene_is_refused(make, message, untyped):
    with pytest.raises(ValueError, match=message):
        make(surfaces.uniform(GREY))


def test_tables_hold_what_is_between_the_near_end_and_the_eye():
    ball = shapes.sphere((0, 0, -0.06), 0.03, surfaces.uniform(RED))  # begins at 3 cm
    frame = rendered(Solids.of([Object(ball)]), NOW.turning())
    assert np.isinf(frame.depth).all()
    assert primitives.NEAR_M == 0.05
