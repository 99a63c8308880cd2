"""Techniques that break the contract are told so, before anything runs."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

import hmdjit as hj
from hmdjit.frames.sources import History
from hmdjit.technique_contract.shapes import check_contract

STEPS = {
    "right": lambda past, now: (past, now),
    "no pair": lambda past, now: now,
    "nothing": lambda past, now: None,
    "three": lambda past, now: (past, now, now),
    "interleaved": lambda past, now: (past, now.transpose(1, 2, 0)),
    "grey": lambda past, now: (past, now.mean(axis=0)),
    "bytes": lambda past, now: (past, (255 * now).astype(jnp.uint8)),
    "forgets": lambda past, now: (None, now),
    "less": lambda past, now: (History.of(now[:1]), now),
}


class Wrong(hj.techniques.AbstractTechnique):
    """Does what it is told to."""

    what: str = eqx.field(static=True, default="right")

    @property
    def id(self):
        return "mine"

    def init(self, frame):
        return History.of(frame.color[0])

    def step(self, state, frame, motion):
        shown = frame.color[0]
        return STEPS[self.what](History.of(shown), shown)


class Unhashed(Wrong):
    mode: str = "fast"  # not said to be static


class Nameless(Wrong):
    id = None  # type: ignore[assignment]


class Vague(Wrong):
    needs = "color"  # type: ignore[assignment]


class Flat(Wrong):
    sample_offsets_px = np.zeros((4, 2))  # type: ignore[assignment]


CASES = [
    (Wrong("no pair"), r"step of mine must return \(state, displayed\), got array of"),
    (Wrong("nothing"), r"must return \(state, displayed\), got None"),
    (Wrong("three"), r"must return \(state, displayed\), got tuple of float32"),
    (
        Wrong("interleaved"),
        r"must display \(3, height, width\).* got array of float32 ",
    ),
    (Wrong("grey"), r"must display .* got array of float32 \(31, 33\)"),
    (Wrong("bytes"), r"must display .* got array of uint8 \(3, 31, 33\)"),
    (Wrong("forgets"), r"must return a state of the shapes .* got None"),
    (Wrong("less"), r"of the one before, History of float32 \(1, 1, 3, .* \(1, 1, 1, "),
    (Unhashed(), r"mode of mine must be a number, an array or .*static.* got 'fast'"),
    (Nameless(), r"id of a technique must be a string, got None"),
    (Vague(), r"needs of mine must be a frozenset with 'color', got 'color'"),
    (Flat(), r"sample_offsets_px of mine must be .* got array of float64 \(4, 2\)"),
    ("none", r"technique must be an AbstractTechnique, got 'none'"),
]


@pytest.mark.parametrize(("technique", "message"), CASES)
def test_a_broken_contract_is_named(technique, message, untyped):
    with pytest.raises(ValueError, match=message):
        check_contract(technique)


@pytest.mark.parametrize("id", ["none", "freeze", "ssaa2", "head_movement"])
def test_what_keeps_it_passes(id):
    check_contract(hj.techniques.by_id(id))
    check_contract(Wrong())


@pytest.mark.parametrize("technique", [Wrong("grey"), Nameless(), "none"])
def test_every_door_checks_it(technique, untyped):
    with pytest.raises(ValueError, match="must"):
        hj.simulate(small.NOISE, small.CAMERA, technique, small.STILL)
    with pytest.raises(ValueError, match="must"):
        small.study(techniques=[technique], baseline="mine").run(0)
    with pytest.raises(ValueError, match="must"):
        hj.techniques.check(technique)
    frames = np.zeros((len(small.STILL), *small.SIZE))
    with pytest.raises(ValueError, match="must"):
        hj.apply(technique, small.CAMERA, frames, small.STILL)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": {"a": "noise"}}, r"scene 'a' must be .* got an instance of str"),
        ({"head": "seated"}, r"head must be a HeadMotion or Replay, got 'seated'"),
    ],
)
def test_what_is_named_instead_of_given_is_refused(changes, message, untyped):
    with pytest.raises(ValueError, match=message):
        small.study(**changes)


def test_a_warm_up_is_known_while_compiling(untyped):
    none = hj.techniques.NoAntialiasing()
    run = lambda k: hj.simulate(small.NOISE, small.CAMERA, none, small.STILL, warmup=k)
    with pytest.raises(ValueError, match=r"warmup must be .* got a traced one"):
        jax.jit(run)(1)
    with pytest.raises(
        ValueError, match=r"warmup must be a whole number >= 0, got Arr"
    ):
        run(jnp.asarray(1))


@pytest.mark.parametrize(
    "key", [0, jnp.uint32(3), jax.random.split(jax.random.key(0)), "0", None]
)
def test_a_key_is_a_random_key(key, untyped):
    with pytest.raises(
        ValueError, match=r"key must be one random key, as jax\.random\."
    ):
        hj.HeadMotion.seated().sample(key, 60.0, 4)
