"""A program models only what its scene and its techniques require."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit import rendering
from hmdjit.frames.displacement import GATHER
from hmdjit.frames.frame import CHANNELS
from hmdjit.frames.neck import NeckModel
from hmdjit.frames.sources import History
from hmdjit.scenes import shapes, surfaces
from hmdjit.scenes.shapes import Movement, Object
from hmdjit.scenes.solids import Solids
from hmdjit.simulation.session import session
from hmdjit.techniques import by_id

CAMERA = hj.Camera(32, 24, fov_deg=60.0, refresh_hz=60.0)
WHOLE = hj.Region.whole(CAMERA)
GREY, FIELDS = (
    surfaces.uniform((0.5, 0.5, 0.5)),
    ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), 0.2),
)
TECHNIQUES = (
    "none",
    "freeze",
    "msaa4",
    "ssaa2",
    "head_movement",
    "head_movement+msaa4",
)


def solids(movement=None, surface=GREY):
    return Solids.of(
        [
            Object(shapes.box((0.2, 0, -3), (1.0, 1.2, 0.5), surface)),
            Object(shapes.sphere((-0.8, 0, -3), 0.5, GREY), movement),
        ]
    )


def still(position=True):
    zero = jnp.zeros(3)
    return hj.Motion(zero, zero, *((zero, zero) if position else ()))


def inputs(function, *arguments):
    """Names of the inputs that the compiled program of a function reads."""
    text = jax.jit(function).lower(*arguments).compile().as_text() or ""
    named = r"parameter\(\d+\).*?op_name=\"((?:scene|motion|camera)[\w.\[\]]*)\""
    return set(re.findall(named, text))


def flops(function, *arguments):
    cost = jax.jit(function).lower(*arguments).compile().cost_analysis()
    assert cost is not None
    return cost["flops"]


def frame_inputs(scene, channels, motion=None):
    def render(scene, motion, camera):
        region = hj.Region(0, 0, 32, 24)
        frame = rendering.render(
            scene, camera, region, motion, np.zeros((1, 2)), channels=channels
        )
        return frame.color, dict(frame.channels)

    return inputs(render, scene, still() if motion is None else motion, CAMERA)


def about(names, *words):
    return {name for name in names if any(word in name for word in words)}


def test_colour_of_a_still_scene_reads_neither_motion_nor_identity():
    names = frame_inputs(solids(), {"color"})
    assert about(names, "rows.centre", "paint.first", "motion.offset", "position_m")
    assert not about(names, "paths", "object", "classes", "increment", "translation")
    # One colour per surface: no pattern.
    assert not about(names, "paint.kind", "paint.second", "paint.cell_m", "paint.mask")


@pytest.mark.parametrize(
    ("channel", "more"),
    [
        ("depth", ()),
        ("albedo", ()),
        ("coverage", ()),
        ("object_id", ("object",)),
        ("motion_class", ("object", "classes")),
        ("velocity", ("increment", "translation")),
    ],
)
def test_a_channel_reads_what_it_is_made_of(channel, more):
    plain = frame_inputs(solids(), {"color"})
    added = frame_inputs(solids(), {"color", channel}) - plain
    assert {word for word in more if about(added, word)} == set(more)
    assert about(added, *more) == added if more else not added


def test_what_moves_by_itself_is_told_its_time_and_no_more():
    names = frame_inputs(solids(Movement((1.0, 0.0, 0.0))), {"color"})
    assert about(names, "paths.velocity", "object", "refresh_hz")
    assert not about(names, "classes", "increment", "translation")


def test_a_head_that_only_turns_before_a_still_scene_needs_no_field_of_velocity():
    motion, names = still(position=False), {"color", "velocity"}
    read = frame_inputs(solids(), names, motion)
    assert not about(read, "increment", "translation", "refresh_hz", "object")
    for scene in (solids(), small.texture(np.random.default_rng(0), CAMERA)):
        frame = rendering.render(
            scene, CAMERA, WHOLE, motion, np.zeros((1, 2)), channels=names
        )
        assert not frame.channels
        assert frame.reprojection(motion) == frame.displacement(motion.increment)


def test_patterns_are_only_where_a_scene_has_them():
    names = frame_inputs(solids(surface=surfaces.checkerboard(*FIELDS)), {"color"})
    assert about(names, "paint.kind", "paint.second", "paint.cell_m")
    assert not about(names, "paint.mask")


class Reader(hj.techniques.AbstractTechnique):
    """Shows what it reads of some channel, from where the content was."""

    channel: str = eqx.field(static=True, default="depth")

    @property
    def id(self):
        return "reader"

    @property
    def needs(self):
        return frozenset({"color", self.channel})

    def init(self, frame):
        return History.of(frame.color[0])

    def step(self, state, frame, motion):
        shown = frame.color[0]
        if self.channel == "velocity":
            shown = state.at(frame.reprojection(motion))
        return History.of(shown), shown


def jaxpr(source, technique):
    motion = jax.tree.map(lambda x: x[None].repeat(3, 0), still(source is not PICTURE))
    run = lambda source, motion: session(
        source, CAMERA, (technique,), motion, WHOLE, WHOLE, warmup=0, reading=GATHER
    )
    return str(jax.make_jaxpr(run)(source, motion))


PICTURE = small.texture(np.random.default_rng(0), CAMERA)
SOURCES = {
    "picture": PICTURE,
    "still": solids(),
    "moving": solids(Movement((1.0, 0.0, 0.0))),
}


@pytest.mark.parametrize("kind", SOURCES)
@pytest.mark.parametrize("id", TECHNIQUES)
def test_no_technique_of_colour_alone_has_another_channel_in_its_program(
    monkeypatch, kind, id
):
    # The source is asked for colours only; then no other channel can be in the program.
    source, technique = SOURCES[kind], by_id(id)
    technique = technique.on_pictures() if kind == "picture" else technique
    asked = set()
    seen = type(source).seen

    def spying(self, view, samples_px, channels):
        asked.update(channels)
        return seen(self, view, samples_px, channels)

    monkeypatch.setattr(type(source), "seen", spying)
    found = jaxpr(source, technique)
    assert asked <= {"color", "supersampled", "multisampled"}
    if kind == "picture":  # a channel of it is one number
        assert not re.search(r"while|\binf\b", found.replace("-inf", ""))


def test_constants_of_a_picture_are_one_number_each():
    now = still(position=False)
    names = set(CHANNELS) - {"velocity"}
    frame = rendering.render(
        PICTURE, CAMERA, WHOLE, now, np.zeros((1, 2)), channels=names
    )
    assert np.isinf(frame.depth).all()
    assert not np.asarray(frame.object_id).any()
    assert not np.asarray(frame.motion_class).any()
    np.testing.assert_array_equal(frame.albedo, frame.color[0])

    def cost(channels):
        def render(source):
            one = np.zeros((1, 2))
            return rendering.render(
                source, CAMERA, WHOLE, now, one, channels=channels
            ).color

        return flops(render, PICTURE)

    assert cost(names) == cost({"color"})


def test_no_antialiasing_on_solids_costs_what_colour_costs():
    source = SOURCES["moving"]
    motion = jax.tree.map(lambda x: x[None].repeat(3, 0), still())
    metrics = (hj.metrics.MTCD(),)

    whole = flops(
        lambda source: (
            session(
                source,
                CAMERA,
                (by_id("none"),),
                motion,
                WHOLE,
                WHOLE,
                warmup=0,
                metrics=metrics,
            )[0].metrics
        ),
        source,
    )

    def colours(source):
        def frame(before, step):
            k, now = step
            shown = rendering.render(
                source, CAMERA, WHOLE, now, np.zeros((1, 2)), frame=k
            ).color[0]
            total = metrics[0].step(jnp.zeros((2, 2)), shown, before, None)
            return shown, total

        start = jnp.zeros((3, 24, 32))
        steps = (jnp.arange(3, dtype=jnp.int32), motion)
        return jax.lax.scan(frame, start, steps)[1]

    assert whole <= 1.02 * flops(colours, source)


def test_techniques_that_sample_alike_share_one_picture():
    # The third and fourth ask for more of the same samples.
    source, asked = SOURCES["still"], []
    motion = jax.tree.map(
        lambda x: x[None].repeat(3, 0),
        NeckModel().moved(hj.Motion(jnp.zeros((1, 3)), jnp.zeros((1, 3)))),
    )
    motion = jax.tree.map(lambda x: x[:, 0], motion)

    class Spy(Solids):
        def seen(self, view, samples_px, channels):
            asked.append(frozenset(channels))
            return super().seen(view, samples_px, channels)

    spy = Spy(**vars(source))
    techniques = (by_id("none"), by_id("head_movement"), Reader(), Reader("velocity"))
    run = lambda source: session(
        source,
        CAMERA,
        techniques,
        motion,
        WHOLE,
        WHOLE,
        warmup=0,
        metrics=(hj.metrics.MTCD(),),
    )
    jax.eval_shape(run, spy)
    assert asked[-1] == {"color", "depth", "velocity"}
