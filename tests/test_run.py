import json
import re
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
import xarray

import hmdjit as hj
from hmdjit.estimates.summary import summarize
from hmdjit.scenes.base import AbstractScene
from hmdjit.simulation.halo import needed_halo_px
from hmdjit.simulation.session import Result
from hmdjit.studies import runner as batches
from hmdjit.studies import stage
from hmdjit.studies.failures import FailedSessionsError, Failures
from hmdjit.studies.measured_blocks import CentralCrop, Tiles, WholeFrame
from hmdjit.technique_contract.base import AbstractSpatial

CAMERA = small.CAMERA_8_PX_PER_DEG
IDS = ("none", "msaa4", "head_movement", "freeze", "ssaa4")
BOARD = {"board": hj.scenes.checkerboard(square_deg=1.0)}


def _study(**changes):
    """On two scenes."""
    return small.study(**({"scenes": {"noise": small.NOISE} | BOARD} | changes))


@pytest.fixture(scope="module")
def data():
    return _study().run(seed=5)


def _plain(**changes):
    """The same sessions, of the technique that is compiled soonest."""
    return _study(**{"techniques": [hj.techniques.NoAntialiasing()]} | changes)


@pytest.fixture(scope="module")
def plain():
    return _plain().run(seed=5, batch_size=5)


@pytest.mark.slow
def test_rows_mean_what_they_say():
    rows = [hj.techniques.by_id(id) for id in IDS]
    data = _study(techniques=rows, baseline="msaa4").run(seed=5)
    assert dict(data.sizes) == {"technique": 5, "scene": 2, "session": 12}
    mtcd, loss = data["mtcd"], data["detail_loss"]
    # On a picture MSAA is no anti-aliasing, exactly; frozen pictures do not flicker.
    np.testing.assert_array_equal(
        mtcd.sel(technique="msaa4"), mtcd.sel(technique="none")
    )
    assert (mtcd.sel(technique="freeze") == 0).all()
    assert (loss.sel(technique="ssaa4") == 0).all()
    assert (loss.sel(technique="freeze") > loss.sel(technique="none")).all()
    means = mtcd.mean("session")
    assert (means.sel(technique="head_movement") < means.sel(technique="none")).all()


def test_results_identify_themselves(plain):
    attributes = plain.attrs
    assert attributes["px_per_deg_centre"] == pytest.approx(
        CAMERA.focal_px * np.pi / 180, rel=1e-6
    )
    for name in ("config_hash", "model_version", "jax_version", "device", "head"):
        assert attributes[name]
    assert json.loads(attributes["failed_sessions"]) == []
    assert (plain["rotation_deg"] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("batch_size", [1, 5])
def test_bits_do_not_depend_on_the_batch(data, batch_size):
    again = _study().run(seed=5, batch_size=batch_size)
    xarray.testing.assert_identical(data.drop_attrs(), again.drop_attrs())


@pytest.mark.slow
def test_the_first_sessions_of_a_longer_study_are_the_shorter_one(data):
    longer = _study(sessions=20).run(seed=5)
    xarray.testing.assert_identical(
        longer.isel(session=slice(12)).drop_attrs(), data.drop_attrs()
    )
    assert not np.array_equal(_study().run(seed=6)["mtcd"], data["mtcd"])


def test_an_interrupted_study_goes_on_and_equals_an_uninterrupted_one(tmp_path, plain):
    def stop_in_the_middle(event):
        if event.done > event.total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _plain().run(seed=5, out=tmp_path, batch_size=5, progress=stop_in_the_middle)
    assert not (tmp_path / "result.nc").exists()
    kept = set((tmp_path / "batches").iterdir())
    assert kept
    events = []
    resumed = _plain().run(seed=5, out=tmp_path, batch_size=5, progress=events.append)
    xarray.testing.assert_identical(resumed.drop_attrs(), plain.drop_attrs())
    assert resumed.attrs["config_hash"] == plain.attrs["config_hash"]
    assert 0 < events[-1].fresh < events[-1].total == events[-1].done
    assert kept < set((tmp_path / "batches").iterdir())

    # Once finished, nothing is computed again.
    _plain().run(seed=5, out=tmp_path, batch_size=5, progress=events.append)
    assert events[-1].fresh == 0
    with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as written:
        np.testing.assert_array_equal(written["mtcd"], plain["mtcd"])


@pytest.mark.slow
def test_changing_anything_that_decides_a_batch_computes_it_anew(tmp_path):
    small = {
        "sessions": 3,
        "scenes": {"noise": hj.scenes.power_law_noise()},
        "techniques": [hj.techniques.NoAntialiasing()],
    }
    _study(**small).run(seed=0, out=tmp_path)
    changes = [
        {"warmup": 2},
        {"head": hj.HeadMotion((1.0, 1.0, 1.0), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))},
        {"scenes": {"noise": hj.scenes.power_law_noise(seed=1)}},
        {"margin_deg": 3.0},
        {"camera": hj.Camera(64, 64, fov_deg=8.0, refresh_hz=72.0)},
    ]
    for change in changes:
        events = []
        _study(**(small | change)).run(
            seed=0, out=tmp_path, overwrite=True, progress=events.append
        )
        assert events[-1].fresh == events[-1].total, change


@pytest.fixture
def simulated(monkeypatch):
    """Studies whose sessions measure nothing, and which techniques were run."""
    ran = []

    def run(self, techniques, texture, batch):
        ran.append([technique.id for technique in techniques])
        ones = np.ones(batch.size)
        return [Result({"mtcd": ones, "detail_loss": ones}) for _ in techniques]

    monkeypatch.setattr(batches.Runner, "run", run)
    return ran


FACTOR = 0.5


class Dimmed(AbstractSpatial):
    """Of a user's own, with a number from elsewhere."""

    id = "dimmed"  # type: ignore[assignment]

    def resolve(self, frame):
        return FACTOR * frame.color[0]


class Versioned(Dimmed):
    version = 1


class Grey(AbstractScene):
    """Scene of a user's own."""

    name: str = eqx.field(static=True, default="grey")

    def color(self, camera, direction):
        return jnp.full_like(direction, FACTOR)


def _of_ones_own(technique, **changes):
    techniques = [hj.techniques.NoAntialiasing(), technique]
    settings = {"techniques": techniques, "sessions": 2, "measure": WholeFrame()}
    return small.study(**settings | changes)


def test_what_no_version_knows_is_never_kept(tmp_path, simulated, monkeypatch):
    monkeypatch.setattr(jax, "clear_caches", lambda: None)  # nothing of ours is run
    events = []
    own = _of_ones_own(Dimmed())
    for _ in range(2):
        own.run(out=tmp_path, progress=events.append)
    assert simulated == [["none", "dimmed"], ["dimmed"]]
    line = "Not kept for another run, for they name no version: Dimmed."
    assert [event.line for event in events if event.line] == [line] * 2
    simulated.clear()
    for _ in range(2):
        _of_ones_own(Versioned()).run(out=tmp_path, overwrite=True)
    assert simulated == [["dimmed"]]
    simulated.clear()
    scene = _of_ones_own(Versioned(), scenes={"mine": Grey()})
    for _ in range(2):
        scene.run(out=tmp_path, overwrite=True)
    assert simulated == [["none", "dimmed"]] * 2


def test_classes_that_differ_in_their_code_only_are_told_apart(simulated):
    def scaled(factor):
        class Scaled(AbstractSpatial):
            id = f"scaled_{factor}"  # type: ignore[assignment]

            def resolve(self, frame):
                return factor * frame.color[0]

        return Scaled()

    techniques = [scaled(0.2), scaled(0.4)]
    small.study(
        techniques=techniques, baseline="scaled_0.2", measure=WholeFrame()
    ).run()
    assert simulated == [["scaled_0.2", "scaled_0.4"]]


@pytest.mark.slow
def test_a_number_changed_elsewhere_changes_the_result(tmp_path, monkeypatch):
    before = _of_ones_own(Dimmed()).run(out=tmp_path)["mtcd"]
    monkeypatch.setitem(globals(), "FACTOR", 0.25)
    after = _of_ones_own(Dimmed()).run(out=tmp_path)["mtcd"]
    np.testing.assert_array_equal(before[0], after[0])
    np.testing.assert_allclose(after[1], before[1] / 2, rtol=1e-5)


@pytest.mark.slow
def test_settings_of_jax_that_move_numbers_are_of_the_key(tmp_path, simulated):
    _plain().run(out=tmp_path)
    with jax.default_matmul_precision("highest"):
        _plain().run(out=tmp_path)
    assert simulated == [["none"]] * 4


def _sizes(folder):
    """First session and number of them of each kept batch."""
    names = [path.stem.split("-") for path in folder.glob("batches/*.npz")]
    return sorted((int(name[-3]), int(name[-2])) for name in names)


def test_more_sessions_run_the_new_ones_only(tmp_path, plain):
    once = {"scenes": {"noise": small.NOISE}}
    for count, size in ((5, 256), (7, 3), (12, 4)):
        data = _plain(sessions=count, **once).run(5, out=tmp_path, batch_size=size)
        expected = plain.sel(scene=["noise"]).isel(session=slice(count))
        xarray.testing.assert_identical(data.drop_attrs(), expected.drop_attrs())
    assert _sizes(tmp_path) == [(0, 5), (5, 2), (7, 4), (11, 1)]


def test_a_technique_that_joins_later_lacks_what_it_lacks(tmp_path, simulated):
    more = [hj.techniques.NoAntialiasing(), hj.techniques.Freeze()]
    small.study(techniques=more, sessions=5).run(out=tmp_path, batch_size=3)
    more += [hj.techniques.HeadMovement()]
    small.study(techniques=more, sessions=8).run(out=tmp_path, batch_size=4)
    new = [["head_movement"], ["head_movement"], ["none", "freeze", "head_movement"]]
    assert simulated == [["none", "freeze"]] * 2 + new
    assert _sizes(tmp_path) == [(0, 3), (0, 4), (3, 2), (4, 1), (5, 3)]


def test_damaged_batches_are_told_and_run_again(tmp_path, plain):
    _plain().run(5, out=tmp_path, batch_size=5)
    result, events = (tmp_path / "result.nc").read_bytes(), []
    cut, altered, *_ = sorted(tmp_path.glob("batches/noise*.npz"))
    cut.write_bytes(cut.read_bytes()[:-1])
    altered.write_bytes(altered.read_bytes().replace(b"mtcd", b"MTCD"))
    _plain().run(5, out=tmp_path, batch_size=5, progress=events.append)
    lines = [event.line for event in events if event.line]
    assert lines == [f"Damaged, and run again: {path}" for path in (cut, altered)]
    assert events[-1].fresh == 5 + 2
    assert (tmp_path / "result.nc").read_bytes() == result


@pytest.mark.parametrize(
    ("changes", "seed", "message"),
    [
        ({}, 1, r"other seed\)"),
        ({"margin_deg": 3.0}, 0, r"other margin_deg\)"),
        ({"sessions": 3}, 0, r"other sessions\)"),
        ({"scenes": BOARD}, 0, r"other scene noise\)"),
        (
            {"techniques": [hj.techniques.Freeze()], "baseline": "freeze"},
            0,
            r"other baseline, technique none\)",
        ),
    ],
)
def test_another_study_s_result_is_not_replaced(
    changes, seed, message, tmp_path, simulated
):
    _plain(sessions=4).run(out=tmp_path)
    before = (tmp_path / "result.nc").read_bytes()
    other = _plain(**{"sessions": 4} | changes)
    if changes != {"sessions": 3}:  # of which batches alone lose nothing
        (tmp_path / "result.nc").unlink()
        with pytest.raises(ValueError, match=f"batches of another.*{message}"):
            other.run(seed, out=tmp_path)
        (tmp_path / "result.nc").write_bytes(before)
    with pytest.raises(ValueError, match=message) as stop:
        other.run(seed, out=tmp_path)
    assert "name another folder, or replace it with overwrite=True" in str(stop.value)
    assert (tmp_path / "result.nc").read_bytes() == before
    other.run(seed, out=tmp_path, overwrite=True)
    assert (tmp_path / "result.nc").read_bytes() != before


def test_a_study_s_own_part_is_replaced(tmp_path, simulated, untyped):
    _plain(sessions=4, scenes=BOARD, margin_deg=4).run(out=tmp_path)
    more = [hj.techniques.NoAntialiasing(), hj.techniques.Freeze()]
    _study(techniques=more, sessions=5).run(out=tmp_path)
    (tmp_path / "result.nc").write_bytes(b"of something else")
    with pytest.raises(ValueError, match=r"other what wrote it\)"):
        _plain().run(out=tmp_path)


@pytest.mark.slow
def test_one_compilation_serves_all_techniques_and_scenes(monkeypatch):
    traced = []
    one_session = batches.session

    def counted(source, camera, techniques, *arguments, **options):
        traced.append([technique.id for technique in techniques])
        return one_session(source, camera, techniques, *arguments, **options)

    monkeypatch.setattr(batches, "session", counted)
    jax.clear_caches()
    rows = [hj.techniques.by_id(id) for id in ("none", "msaa4", "freeze")]
    _study(techniques=rows, sessions=7).run(seed=0, batch_size=4)
    # MSAA shares the run of none; the last batch is filled up to the others' size.
    assert traced == [["none", "freeze"]]


@pytest.mark.slow
def test_tiles_crop_and_whole_frame_measure_the_same_kind_of_thing():
    means = {}
    for measure in (Tiles(2, 16), CentralCrop(32), WholeFrame()):
        data = _study(measure=measure, sessions=10).run(seed=1)
        means[type(measure)] = float(data["mtcd"].sel(technique="none").mean())
        assert np.isfinite(data["mtcd"]).all()
    # The field is narrow, so the picture moves alike everywhere.
    assert means[CentralCrop] == pytest.approx(means[WholeFrame], rel=0.3)
    assert means[Tiles] == pytest.approx(means[WholeFrame], rel=0.3)


@pytest.mark.exhaustive
def test_tile_means_agree_with_whole_frames():
    """Unbiased: the same sessions by tiles and by whole frames, on three scenes."""
    camera = hj.Camera(256, 256, fov_deg=80.0)  # fast at its sides, slow in its centre
    scenes = {
        "noise": hj.scenes.power_law_noise(),
        "board": hj.scenes.checkerboard(),
        "plate": hj.scenes.zone_plate(),
    }
    common = {"camera": camera, "scenes": scenes, "sessions": 150, "margin_deg": 4.0}
    tiled = _study(measure=Tiles(4, 32), **common).run(seed=3)
    whole = _study(measure=WholeFrame(), **common).run(seed=3)
    for name in ("mtcd", "detail_loss"):
        difference = (tiled[name] - whole[name]).sel(
            technique=["none", "head_movement"]
        )
        error = difference.std("session", ddof=1) / np.sqrt(difference.sizes["session"])
        z = np.abs(difference.mean("session") / error)
        # 12 z-tests below 4 in all: false alarm 12 x 6.3e-5 < 0.1 %.
        assert float(z.max()) < 4, (name, z.values)


def test_sessions_that_need_a_wider_halo_get_one_and_are_counted():
    calm = _study(sessions=6, measure=Tiles(2, 16))
    kim = hj.techniques.HeadMovement()
    batch = stage.drawing(calm, 0)(6).batch(0, 6)
    need = needed_halo_px(kim, calm.display, batch.motion, batch.origins, (16, 16))

    def runner(pilot):
        return batches.Runner(calm.display, calm.measure, [kim], 2, 6, pilot)

    assert not runner(batch).is_wide([kim], batch).any()
    calmest = runner(batch.select(np.array([need.argmin()])))
    halo, usual = calmest.halo([kim], batch), -(-need.min() // 4) * 4
    assert (halo >= need).all()
    np.testing.assert_array_equal(calmest.is_wide([kim], batch), need > usual)


@pytest.mark.slow
def test_a_wide_session_equals_itself_in_a_wide_study():
    """The halo decides how much is rendered, not what is measured."""
    study = _study(sessions=6, measure=Tiles(1, 16))
    texture = hj.scenes.bake(small.NOISE, CAMERA, margin_deg=4.0)
    kim = hj.techniques.HeadMovement()
    batch = stage.drawing(study, 0)(6).batch(0, 6)
    runner = batches.Runner(CAMERA, study.measure, [kim], study.warmup, 6, batch)
    (usual,) = runner.run([kim], texture, batch)
    still = jax.tree.map(np.zeros_like, batch.motion)
    for pilot in (batch._replace(motion=still), batch):
        other = batches.Runner(CAMERA, study.measure, [kim], study.warmup, 6, pilot)
        (again,) = other.run([kim], texture, batch)
        # Errors beyond a halo reach the tile with less than 1e-5 of the colour range;
        # MTCD moves by at most 2 x 255 x sqrt(3) times that.
        np.testing.assert_allclose(again.mtcd, usual.mtcd, atol=9e-3)


@pytest.mark.slow
def test_sessions_that_leave_the_margin_are_named_and_stop_the_study():
    restless = hj.HeadMotion((60.0, 60.0, 1.0), (0.5, 0.5, 0.1), (0.0, 0.0, 0.0))
    study = _study(head=restless, margin_deg=0.5)
    message = r"of 12 sessions gave no finite number \(\d.*margin_deg = 0\.5 from"
    with pytest.raises(FailedSessionsError, match=message):
        study.run(seed=0)


def _replay_with_a_turn():
    """Ten windows of still heads; in one the head turns out of the margin."""
    still = np.zeros((70, 3))
    still[30:35, 1] = np.radians(np.linspace(1, 8, 5))
    poses = np.asarray(jax.vmap(hj.quaternion.exp)(jnp.asarray(still)))
    trace = hj.Trace(np.arange(70) / 60, poses)
    return _plain(head=hj.Replay([trace]), scenes=BOARD, sessions=10)


def test_a_session_that_fails_is_left_out_only_by_choice(tmp_path, monkeypatch):
    study = _replay_with_a_turn()
    with pytest.raises(FailedSessionsError, match=r"at most 1% may") as stop:
        study.run(seed=0)
    assert "kept" not in str(stop.value)
    monkeypatch.setattr("hmdjit.studies.failures.MOST_FAILED", 0.1)
    with pytest.raises(FailedSessionsError) as stop:
        study.run(seed=0, out=tmp_path)
    found = re.fullmatch(
        r"1 of 10 sessions gave no finite number \((\d)\); omit_failed=True "
        r"leaves them out\. One cause is a head that turns more than margin_deg = 4 "
        r"from where it started\. Finished batches are kept in (.*)\.",
        str(stop.value),
    )
    assert found
    assert found[2] == str(tmp_path)
    assert not (tmp_path / "result.nc").exists()

    # What the study that stopped has kept is all that the other needs.
    events = []
    data = study.run(seed=0, out=tmp_path, omit_failed=True, progress=events.append)
    assert events[-1].fresh == 0
    failed = int(found[1])
    assert json.loads(data.attrs["failed_sessions"]) == [failed]
    assert data.attrs["omit_failed"] == 1
    assert np.flatnonzero(np.isnan(data["mtcd"][0, 0])).tolist() == [failed]
    row = summarize(data)[0]
    assert row.mean == pytest.approx(float(data["mtcd"][0, 0].mean(skipna=True)))
    assert row.sessions == 9
    with xarray.open_dataset(tmp_path / "result.nc", engine="h5netcdf") as written:
        assert written.attrs["omit_failed"] == 1


def test_a_choice_leaves_out_no_more_than_may_fail(monkeypatch):
    monkeypatch.setattr("hmdjit.studies.failures.MOST_FAILED", 0.09)
    with pytest.raises(FailedSessionsError, match=r"at most 9% may, with omit_fail"):
        _replay_with_a_turn().run(seed=0, omit_failed=True)


def test_a_study_that_stops_early_says_how_far_it_is(monkeypatch):
    def fail(self, techniques, texture, batch):
        nothing = np.full(batch.size, np.nan)
        return [Result({"mtcd": nothing, "detail_loss": nothing}) for _ in techniques]

    monkeypatch.setattr(batches.Runner, "run", fail)
    message = r"9 of 12 sessions \(9 run so far\) gave"
    with pytest.raises(FailedSessionsError, match=message):
        _plain().run(seed=5, batch_size=9)


@pytest.mark.slow
def test_the_choice_is_no_part_of_what_sessions_are(data):
    again = _study().run(seed=5, omit_failed=True)
    xarray.testing.assert_identical(data.drop_attrs(), again.drop_attrs())
    assert data.attrs["omit_failed"] == 0
    same = data.attrs | {"omit_failed": 1}
    assert again.attrs == same


def test_few_of_many_sessions_may_be_left_out():
    few, many = list(range(5)), list(range(6))
    stop, omit = (Failures(omit, 6.0, None) for omit in (False, True))
    stop.check([], 500)
    omit.check(few, 500)
    for failures, failed, choice in (
        (stop, [7], "leaves them out"),
        (stop, few, "leaves them out"),
        (stop, many, r"at most 1% may"),
        (omit, many, r"at most 1% may"),
    ):
        words = rf"{len(failed)} of 500 sessions gave.*{choice}"
        with pytest.raises(FailedSessionsError, match=words):
            failures.check(failed, 500)
    with pytest.raises(FailedSessionsError, match=r"\(0, 1, .*, 9, \.\.\.\);"):
        stop.check(list(range(30)), 40)


@pytest.mark.slow
def test_replays_carry_their_subjects_and_their_rate():
    traces = []
    for i, subject in enumerate("ab"):
        poses = hj.HeadMotion.seated().sample(jax.random.key(i), 90.0, 40)
        traces.append(hj.Trace(np.arange(40) / 90, np.asarray(poses), subject=subject))
    data = _study(head=hj.Replay(traces)).run(seed=0)
    assert data.sizes["session"] == 2 * (40 // 7)
    assert data.attrs["refresh_hz"] == pytest.approx(90.0)
    assert set(data["subject"].values) == {"a", "b"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sessions": 0}, r"sessions must be a whole number >= 1, got 0"),
        ({"frames": 1}, r"frames must be a whole number >= 2, got 1"),
        ({"warmup": -1}, r"warmup must be a whole number >= 0, got -1"),
        ({"baseline": "nine"}, r"baseline must be one of .* Did you mean 'none'"),
        ({"oversampling": 3}, r"oversampling must be 1, 2 or 4, got 3"),
        ({"margin_deg": 90.0}, r"margin_deg must lie in"),
        ({"scenes": {"all": hj.scenes.uniform()}}, r"scenes must not be named 'all'"),
        ({"scenes": {}}, r"scenes must name at least one scene"),
        ({"techniques": []}, r"techniques must name at least one"),
        (
            {"techniques": [hj.techniques.SSAA(2), hj.techniques.SSAA(2)]},
            r"techniques must have distinct ids, got ssaa2, ssaa2",
        ),
        ({"measure": Tiles(2, 48)}, r"tiles size_px must divide"),
    ],
)
def test_wrong_studies_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        _study(**changes)


_PEAK_MEMORY = """
import resource
import hmdjit as hj
from hmdjit.studies.measured_blocks import Tiles

def run(sessions):
    hj.Study(
        scenes={"noise": hj.scenes.power_law_noise()},
        techniques=[hj.techniques.NoAntialiasing()],
        head=hj.HeadMotion.seated(),
        camera=hj.Camera(64, 64, fov_deg=8.0),
        sessions=sessions, frames=4, warmup=3, measure=Tiles(2, 16), baseline="none",
    ).run(seed=0, batch_size=50)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)

run(500)
run(1000)
run(8000)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_sessions():
    # A process of its own: the checks of the test run keep memory of what they saw. Its
    # first study warms up caches.
    command = [sys.executable, "-c", _PEAK_MEMORY]
    root = Path(__file__).parents[1]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
    _, before, after = map(int, done.stdout.split())
    # A result is 16 bytes per session, scene and technique: 0.1 MB. 20 MB is slack.
    assert after - before < 20_000


@pytest.mark.slow
def test_techniques_with_array_leaves_are_run(data):
    kim = hj.techniques.HeadMovement(w_min=jnp.asarray(0.3, jnp.float32))
    rows = [hj.techniques.NoAntialiasing(), kim]
    again = _study(techniques=rows).run(seed=5)
    np.testing.assert_allclose(again["mtcd"], data["mtcd"], rtol=1e-5)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_that_would_wrap_around_are_refused(seed):
    with pytest.raises(ValueError, match="seed must"):
        _study().run(seed=seed)
