"""Derivatives of the ratio in every parameter: exact laws, differences, intervals."""

import csv
import io
from typing import Any

import equinox as eqx
import heads
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import small
import viewing
from jax.flatten_util import ravel_pytree
from jaxtyping import Array
from rich.console import Console

import hmdjit as hj
from hmdjit.estimates.intervals import Z95
from hmdjit.frames.displacement import GATHER
from hmdjit.reports import sensitivity as sensitivity_report
from hmdjit.sensitivity import derivatives, sensitivity
from hmdjit.sensitivity.derivatives import Parameters, differentiate
from hmdjit.sensitivity.sensitivity import of_sessions
from hmdjit.simulation import sharding as devices
from hmdjit.studies.failures import FailedSessionsError
from hmdjit.studies.measured_blocks import Tiles, WholeFrame
from hmdjit.studies.runner import Runner
from hmdjit.studies.sessions import Sessions, session_keys, study_key
from hmdjit.technique_contract.base import AbstractSpatial, AbstractTechnique
from hmdjit.techniques import HeadMovement, NoAntialiasing

# People who sit still move this camera's picture by some 0.2 px per frame.
CAMERA = hj.Camera(width_px=8, height_px=6, fov_deg=0.6, refresh_hz=60.0)
FRAMES, WARMUP, SEED = 3, 2, 7
MODELS = heads.models(person_sd=0.2)
# One past sample has weight 1, whatever number says so.
KIM = HeadMovement(w_min=0.35, w_lb=0.15, h_max_deg_s=12.0, weights=(2.0,))
COUNTS = {"frames": FRAMES, "warmup": WARMUP, "seed": SEED, "measure": WholeFrame()}


def scenes(camera=CAMERA, margin_px=12, dtype=float):
    rng = np.random.default_rng(3)
    texture = lambda: viewing.noise_texture(rng, camera, margin_px, dtype=dtype)
    return {"one": texture(), "other": texture()}


TWO = scenes()
ONE = {"one": TWO["one"]}
QUICKLY = {"xla_backend_optimization_level": 0}


def parameters(head, technique: AbstractTechnique = KIM):
    return Parameters(head, CAMERA, technique, NoAntialiasing())


def differentiated(now):
    """Of many sessions: with other numbers, the same programs."""
    return differentiate(TWO, now, sessions=512, batch_size=512, **COUNTS)


def of_head(head, technique=KIM):
    return differentiated(parameters(head, technique))


@pytest.fixture(autouse=True, scope="module")
def _quickly():
    """Optimising a program takes longer than all the rest of a test."""
    measure: Any = derivatives._differentiated
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(devices, "compiler_options", lambda *_: QUICKLY)
        measure.__dict__.pop("jitted", None)
        yield
    measure.__dict__.pop("jitted", None)


@pytest.fixture(scope="module")
def many():
    return of_head(MODELS["A"])


class Tinted(AbstractSpatial):
    """Scales the picture by its strength and its first knot."""

    strength: float
    knots: Array

    @property
    def id(self):
        return "tinted"

    def resolve(self, frame):
        return self.strength * self.knots[0] * frame.color[0]


NUMBERS = {
    "head.speed_rms_deg_s[1]": lambda p: p.head.speed_rms_deg_s[1],
    "camera.fov_deg": lambda p: p.camera.fov_deg,
    "technique.strength": lambda p: p.technique.strength,
}


@pytest.mark.slow
def test_derivatives_of_mtcd_are_central_differences():
    """One number of each kind; further below are all of them."""
    # With a technique that compiles quickly.
    here = parameters(MODELS["A"], Tinted(0.7, jnp.array([0.5, 0.3])))
    of = lambda now: differentiate(ONE, now, sessions=2, **COUNTS)
    found = of(here)
    for name, where in NUMBERS.items():
        # So small a change moves no source across a pixel's centre.
        step = 1e-6 * where(here)
        low, high = (
            of(eqx.tree_at(where, here, where(here) + s)) for s in (-step, step)
        )
        i = found.names.index(name)
        difference = (high.x - low.x) / (2 * step)
        assert found.dx[:, i] == pytest.approx(difference, rel=1e-6)
        assert (found.dx[:, i] != 0).all()


def test_further_fields_come_in_by_themselves():
    technique = Tinted(1.0, jnp.array([0.5, 0.3]))
    found = sensitivity.sensitivities(
        ONE, CAMERA, technique, MODELS["A"], sessions=2, **COUNTS
    )
    rows = {row.name: row for row in found.rows()}
    # MTCD is proportional to the picture's contrast.
    np.testing.assert_allclose(found.ratio.value, 0.5, rtol=1e-12)
    np.testing.assert_allclose(rows["technique.knots[0]"].derivative, 1.0, rtol=1e-12)
    assert rows["technique.knots[1]"].sign == "0"
    assert "tinted over none, one; 2 sessions of 3 frames" in found.about


FEW = 3


def log_ratio(head):
    """Return the ratio's logarithm as a function of one vector, by `simulate`."""
    as_arrays = jax.tree.map(lambda x: jnp.asarray(x, float), parameters(head))
    start, unravel = ravel_pytree(as_arrays)

    def log_ratio(vector):
        now = unravel(vector)

        def one(index):
            key = session_keys(study_key(SEED), index).head
            poses = now.head.sample(key, now.camera.refresh_hz, WARMUP + FRAMES)
            mtcd = lambda texture, technique: (
                hj.simulate(texture, now.camera, technique, poses, warmup=WARMUP).mtcd
            )
            pairs = [
                (mtcd(t, now.technique), mtcd(t, now.baseline)) for t in TWO.values()
            ]
            return jnp.mean(jnp.asarray(pairs), axis=0)

        x, y = jnp.mean(jax.lax.map(one, jnp.arange(FEW)), axis=0)
        return jnp.log(x / y)

    return log_ratio, np.asarray(start)


@pytest.mark.slow
def test_each_derivative_agrees_with_central_differences_and_forward_mode():
    head = MODELS["bursts"]
    found = of_head(head)
    # Session i does not depend on how many there are.
    found = of_sessions(found.select(slice(FEW)))
    function, start = log_ratio(head)
    np.testing.assert_array_equal(found.values, start)
    assert (start > 0).all()
    compiled = jax.jit(function, compiler_options=QUICKLY)
    np.testing.assert_allclose(np.log(found.ratio.value), compiled(start), rtol=1e-10)
    # As for a session alone: a relative change of 1e-6 moves no source across a pixel's
    # centre; values round to a few 1e-15, differences to as many 1e-9.
    relative = lambda x: compiled(jnp.asarray(x * start))
    expected = oracles.jacobian(relative, np.ones(len(start)), step=1e-6)
    np.testing.assert_allclose(found.derivative, expected, rtol=1e-5, atol=4e-9)
    is_idle = np.array([name == "technique.weights[0]" for name in found.names])
    assert (np.abs(found.derivative[~is_idle]) > 1e-7).all()
    assert len(found.names) == 38
    forward = jax.jit(jax.jacfwd(function))(jnp.asarray(start)) * start
    np.testing.assert_allclose(found.derivative, forward, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_differences_along_a_direction_agree(many):
    # All numbers but the refresh rate at once; the law of time ties that to the others.
    rng = np.random.default_rng(5)
    relative = rng.uniform(-1, 1, len(many.names))
    relative[many.names.index("camera.refresh_hz")] = 0.0
    as_arrays = jax.tree.map(lambda x: jnp.asarray(x, float), parameters(MODELS["A"]))
    start, unravel = ravel_pytree(as_arrays)

    def log_ratio(step):
        now = unravel(start * (1 + step * relative))
        camera = eqx.tree_at(lambda c: c.refresh_hz, now.camera, CAMERA.refresh_hz)
        now = eqx.tree_at(lambda p: p.camera, now, camera)
        return np.log(of_sessions(differentiated(now)).ratio.value)

    # A step of 1e-7 takes hardly one of the 50,000 reads across a texel's centre.
    expected = (log_ratio(1e-7) - log_ratio(-1e-7)) / 2e-7
    found = of_sessions(many).derivative @ relative
    assert abs(expected) > 0.05
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.slow
def test_no_unit_of_time_is_special(many):
    # With all times c times as long, all rates and speeds 1 / c times as large, every
    # session is the same: the derivatives along that direction are 0, of each session.
    power = np.array(
        [
            1.0
            if name.partition("[")[0].endswith("time_s")
            else -1.0
            if name.partition("[")[0].endswith(("deg_s", "_hz"))
            else 0.0
            for name in many.names
        ]
    )
    assert (power > 0).sum() == 4
    assert (power < 0).sum() == 5
    for slopes in (many.dx, many.dy):
        along = slopes * many.values
        size = np.abs(along).max()
        np.testing.assert_allclose(along @ power, 0, atol=1e-9 * size)
        assert np.abs(along @ np.abs(power)).max() > 0.1 * size


@pytest.mark.slow
def test_intervals_are_as_wide_as_estimates_scatter(many):
    groups = [of_sessions(many.select(slice(i, i + 32))) for i in range(0, 512, 32)]
    moves = np.array([sign != "0" for sign in groups[0].signs])
    scatter = np.std([g.derivative for g in groups], axis=0, ddof=1)[moves]
    said = np.sqrt(np.mean([g.standard_error**2 for g in groups], axis=0))[moves]
    # Of 16 normal estimates a standard deviation is below 0.38 or above 1.75 times the
    # true one with probability 2e-5 in all; of 17 parameters one is with 4e-4.
    ratio = scatter / said
    assert ((ratio > 0.38) & (ratio < 1.75)).all(), ratio
    # Halves agree: of 17 normal differences one is beyond 4.5 with probability 1e-4.
    first, second = (of_sessions(many.select(slice(i, i + 256))) for i in (0, 256))
    error = np.hypot(first.standard_error, second.standard_error)[moves]
    difference = (first.derivative - second.derivative)[moves]
    assert (np.abs(difference) < 4.5 * error).all()


@pytest.mark.slow
def test_signs_say_which_intervals_leave_out_0(many):
    found = of_sessions(many)
    for row in found.rows():
        expected = "+" if row.low > 0 else "-" if row.high < 0 else "unclear"
        assert row.sign == ("0" if row.name == "technique.weights[0]" else expected)
    by_name = dict(zip(found.names, found.signs, strict=True))
    # More weight on the current picture leaves more of its flicker.
    assert by_name["technique.w_min"] == by_name["technique.w_lb"] == "+"
    # From 50 sessions on, the delta method's.
    width = found.high - found.low
    np.testing.assert_allclose(width, 2 * Z95 * found.standard_error, rtol=1e-12)


@pytest.mark.slow
def test_the_baseline_does_not_depend_on_the_technique(many):
    for name, column in zip(many.names, many.dy.T, strict=True):
        assert (column == 0).all() == name.startswith("technique.")


@pytest.mark.slow
def test_what_has_no_influence_has_the_derivative_0(many):
    found = of_sessions(many)
    at = found.names.index("technique.weights[0]")
    assert found.derivative[at] == found.standard_error[at] == 0
    assert found.signs[at] == "0"
    # Where the head is always too fast, only the current picture is shown.
    always = HeadMovement(0.35, 0.15, 1e-6, weights=(2.0,))
    fast = of_sessions(of_head(MODELS["A"], technique=always))
    np.testing.assert_allclose(fast.ratio.value, 1.0, rtol=1e-12)
    for row in fast.rows():
        if row.name.startswith("technique."):
            # That of h_max is 1e-33: cos(pi / 2) rounds to 6e-17, and is left of it.
            is_rounded = row.name == "technique.h_max_deg_s"
            assert abs(row.derivative) <= (1e-30 if is_rounded else 0)
            assert row.sign == "0" or is_rounded
        else:
            assert abs(row.derivative) < 1e-9


@pytest.mark.slow
def test_numbers_that_are_0_have_derivatives_per_unit():
    still = hj.HeadMotion(
        (1.12, 0.0, 0.93), (0.10, 0.124, 0.029), (0.0037, 0.0036, 0.0), person_sd=0.0
    )
    kim = HeadMovement(0.35, 0.0, 12.0, weights=(2.0,))
    found = of_sessions(of_head(still, technique=kim))
    per = {row.name: row.per for row in found.rows() if row.per != "relative"}
    assert per == {
        "head.speed_rms_deg_s[1]": "deg/s",
        "head.tracker_noise_deg[2]": "deg",
        "head.person_sd": "1",
        "technique.w_lb": "1",
    }
    assert np.isfinite(found.derivative).all()


@pytest.mark.slow
def test_tiles_measure_what_a_study_measures():
    camera = hj.Camera(width_px=48, height_px=32, fov_deg=3.6, refresh_hz=60.0)
    head, kim, tiles = MODELS["A"], HeadMovement(), Tiles(2, 8)
    texture = scenes(camera, 40, jnp.float32)["one"]
    found = differentiate(
        {"one": texture},
        Parameters(head, camera, kim, NoAntialiasing()),
        **{**COUNTS, "measure": tiles},
        sessions=5,
        batch_size=2,
    )
    batch = Sessions(SEED, head, camera, tiles, 5, WARMUP + FRAMES).batch(0, 5)
    runner = Runner(camera, tiles, [kim], WARMUP, 5, batch, GATHER)
    (study,) = runner.run([kim], texture, batch)
    # Both in float32, from the same paths; a halo's edge does less than 1e-5.
    np.testing.assert_allclose(found.x, study.mtcd, rtol=1e-4)


@pytest.mark.slow
def test_other_numbers_do_not_compile_anew(many, monkeypatch):
    traced = []
    of_session = derivatives.session
    counted = lambda *args, **kw: traced.append(args) or of_session(*args, **kw)
    monkeypatch.setattr(derivatives, "session", counted)
    of_head(heads.models(person_sd=0.1)["A"])
    assert not traced


@pytest.mark.slow
def test_tables_name_every_parameter(many, tmp_path):
    found = of_sessions(many)
    with open(sensitivity.write_csv(found, tmp_path / "found.csv")) as file:
        lines = list(csv.DictReader(file))
    assert [line["name"] for line in lines] == list(found.names)
    assert [float(line["derivative"]) for line in lines] == found.derivative.tolist()
    assert [line["sign"] for line in lines] == list(found.signs)
    shown = io.StringIO()
    Console(file=shown, width=100).print(sensitivity_report.table(found))
    for name in found.names:
        assert name in shown.getvalue()
    assert f"R = {found.ratio.value:.4f}" in sensitivity_report.explanation(found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sessions": 1}, "sessions must be a whole number >= 2, got 1"),
        ({"frames": 1}, "frames must be a whole number >= 2, got 1"),
        ({"warmup": -1}, "warmup must be a whole number >= 0, got -1"),
        ({"batch_size": 0}, "batch_size must be a whole number >= 1, got 0"),
        ({"seed": 2**32}, "seed must lie in"),
        ({"scenes": {}}, "scenes must name at least one scene, got none"),
        ({"scenes": {"plates": small.solids()}}, "'plates' must be a picture, got sol"),
        ({"measure": Tiles(1, 4)}, "tiles size_px must divide the camera frame 8 x 6"),
        ({"camera": hj.Camera(16, 6, 0.6)}, "scene must be a texture baked for this"),
        ({"head": "me.csv"}, "head must be a HeadMotion, got str: recorded paths"),
    ],
)
def test_what_cannot_be_is_refused(untyped, change, message):
    options = {"scenes": TWO, "camera": CAMERA, "technique": KIM, "head": MODELS["A"]}
    options = {**options, "sessions": 3, **COUNTS, **change}
    with pytest.raises(ValueError, match=message):
        sensitivity.sensitivities(**options)


@pytest.mark.slow
def test_heads_that_leave_the_margin_are_reported(many):
    fast = heads.models(person_sd=0.2, scale=1e4)["A"]
    with pytest.raises(FailedSessionsError, match="512 of 512 sessions gave no finite"):
        of_head(fast)
