import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hmdjit as hj
from hmdjit.cli.definition import Options, build
from hmdjit.studies.measured_blocks import Tiles
from hmdjit.studies.sessions import Sessions, session_keys, study_key

CAMERA = hj.Camera(64, 64)


def _trace(subject, seconds, rate_hz=90.0, seed=0):
    """Recording whose poses no generator of JAX has drawn."""
    turns = np.random.default_rng(seed).normal(0, 1e-4, (round(seconds * rate_hz), 3))
    poses = Rotation.from_rotvec(np.cumsum(turns, axis=0)).as_quat(scalar_first=True)
    return hj.Trace(np.arange(len(poses)) / rate_hz, poses, subject=subject)


def _sessions(count, head=None, seed=0):
    head = hj.HeadMotion.seated() if head is None else head
    return Sessions(seed, head, CAMERA, Tiles(2, 8), count, 12)


def test_a_session_depends_on_its_number_only():
    whole = _sessions(9).batch(0, 9)
    for start, size in ((0, 4), (4, 4), (8, 4)):
        part = _sessions(9).batch(start, size)
        chosen = slice(start, start + part.size)
        np.testing.assert_array_equal(part.origins, whole.origins[chosen])
        np.testing.assert_array_equal(
            part.motion.increment, whole.motion.increment[chosen]
        )
    assert part.size == 1


def test_sessions_and_seeds_differ():
    first, second = _sessions(40), _sessions(40, seed=1)
    paths = np.asarray(first.batch(0, 40).motion.offset).reshape(40, -1)
    assert len(np.unique(paths, axis=0)) == 40
    others = np.asarray(second.batch(0, 40).motion.offset).reshape(40, -1)
    assert not np.isin(paths[:, 3:], others[:, 3:]).any()


def test_motion_starts_at_the_hold_pose_in_float32():
    motion = _sessions(5).batch(0, 5).motion
    assert motion.offset.dtype == np.float32
    assert (motion.offset[:, 0] == 0).all()
    assert (motion.increment[:, 0] == 0).all()


def test_keys_are_threefry_whatever_the_default():
    with jax.default_prng_impl("rbg"):
        key = study_key(3)
    assert str(jax.random.key_impl(key)) == "threefry2x32"
    keys = session_keys(study_key(3), jnp.int32(0))
    assert (
        jax.random.key_data(keys.head).tolist()
        != jax.random.key_data(keys.blocks).tolist()
    )


@pytest.mark.parametrize("name", ["head", "replay"])
@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("jax_enable_x64", False),
        ("jax_threefry_partitionable", False),
        ("jax_random_seed_offset", 5),
    ],
)
def test_no_setting_of_jax_changes_what_is_drawn(name, setting, value):
    replay = hj.Replay([_trace("a", 2.0)]) if name == "replay" else None
    expected = _sessions(9, replay).batch(0, 9)
    before = getattr(jax.config, setting)
    jax.config.update(setting, value)
    try:
        ours = _sessions(9, replay).batch(0, 9)
    finally:
        jax.config.update(setting, before)
    np.testing.assert_array_equal(ours.origins, expected.origins)
    np.testing.assert_array_equal(ours.motion.increment, expected.motion.increment)


def test_all_tiles_of_a_frame_may_be_drawn():
    # Beyond 2048 tiles places in the frame are more than 32 bits count.
    origins = np.asarray(Tiles(4096, 16).draw(study_key(0), hj.Camera()))
    assert len(np.unique(origins, axis=0)) == 4096


def test_replay_gives_each_window_once_and_names_its_subject():
    traces = [_trace("a", 1.0), _trace("b", 2.0, seed=1)]
    replay = hj.Replay(traces)
    assert replay.refresh_hz == pytest.approx(90.0)
    sessions = _sessions(1000, replay)
    assert sessions.count == 90 // 12 + 180 // 12
    assert (sessions.subjects or []).count("a") == 90 // 12
    batch = sessions.batch(0, sessions.count)
    ends = np.asarray(batch.motion.offset)[:, -1]
    assert len(np.unique(ends, axis=0)) == sessions.count
    # A shorter study begins like a longer one.
    few = _sessions(5, replay).batch(0, 5)
    np.testing.assert_array_equal(few.motion.offset, batch.motion.offset[:5])


def test_replayed_increments_are_the_recorded_ones():
    trace = _trace("a", 0.2)
    batch = _sessions(1, hj.Replay([trace])).batch(0, 1)
    expected = hj.Motion.of(jnp.asarray(trace.world_from_head[:12]))
    np.testing.assert_allclose(batch.motion.increment[0], expected.increment, atol=2e-9)


def test_replay_refuses_what_it_cannot_replay():
    slow, fast = _trace("a", 1.0, 60.0), _trace("b", 1.0, 90.0)
    with pytest.raises(ValueError, match=r"at least one recording"):
        hj.Replay([])
    with pytest.raises(ValueError, match=r"share one rate within 2 %"):
        hj.Replay([slow, fast, fast])
    with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got 0"):
        hj.Replay([slow], rate_hz=0.0)
    with pytest.raises(ValueError, match=r"must last at least 12 frames"):
        _sessions(3, hj.Replay([_trace("a", 0.1)]))


def test_replay_resamples_to_a_named_rate():
    replay = hj.Replay([_trace("a", 1.0, 60.0), _trace("b", 1.0, 90.0)], rate_hz=72.0)
    assert replay.refresh_hz == 72.0
    windows, subjects = replay.windows(12)
    assert windows.shape == (len(subjects), 12, 4)
    assert len(subjects) in (2 * (72 // 12), 2 * (72 // 12) - 1, 2 * (72 // 12) - 2)


def test_a_named_refresh_rate_replays_traces_of_different_rates(tmp_path):
    paths = (tmp_path / "a.csv", tmp_path / "b.csv")
    for path, rate_hz in zip(paths, (60.0, 90.0), strict=True):
        _trace(path.stem, 1.0, rate_hz).write(path)
    small = {"width": 64, "height": 64, "fov": 8.0, "tiles": 1, "scenes": ("noise",)}
    study = build(Options(trace=paths, refresh=72.0, **small))
    assert study.display.refresh_hz == 72.0
    with pytest.raises(ValueError, match="share one rate"):
        build(Options(trace=paths, **small))
