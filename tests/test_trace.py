import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

import hmdjit as hj
from hmdjit.head_motion import Trace

HEADER = "t_s,qw,qx,qy,qz\n"
GOOD = "0.0,1,0,0,0\n0.1,0.8,0.6,0,0\n0.2,0.6,0.8,0,0\n"


@pytest.fixture
def wobble(rng):
    """A head that turns through all axes, its steps up to 0.3 rad, unevenly timed."""
    t_s = 5.0 + np.cumsum(rng.uniform(0.005, 0.03, 300))
    steps = Rotation.from_rotvec(rng.normal(0, 0.1, (300, 3)))
    turned = [steps[0]]
    for step in steps[1:]:
        turned.append(turned[-1] * step)
    poses = Rotation.concatenate(turned).as_quat(scalar_first=True)
    return Trace(t_s, poses, subject="p1")


def angles_between(left, right):
    left = Rotation.from_quat(left, scalar_first=True)
    right = Rotation.from_quat(right, scalar_first=True)
    return (left.inv() * right).magnitude()


def message_of(path):
    with pytest.raises(ValueError, match=r"\S") as caught:
        Trace.read(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- reading and writing ---


def test_what_is_written_is_read(wobble, tmp_path):
    wobble.write(tmp_path / "p1_a_still.csv")
    again = Trace.read(tmp_path / "p1_a_still.csv")
    np.testing.assert_array_equal(again.t_s, wobble.t_s)
    # Normalising a second time may round the last digit.
    np.testing.assert_allclose(
        again.world_from_head, wobble.world_from_head, rtol=0, atol=4e-16
    )
    assert again.subject == "p1_a"
    assert again.name == "p1_a_still.csv"


def test_writing_leaves_the_old_file_until_the_new_one_is_done(
    wobble, tmp_path, monkeypatch
):
    path = tmp_path / "new" / "me.csv"
    wobble.write(path)
    before = path.read_bytes()

    def full_disk(*args, **options):
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_text", full_disk)
    with pytest.raises(OSError, match="No space"):
        wobble.resample(10.0).write(path)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("name", "subject"),
    [("crom_p04_t014_still.csv", "crom_p04"), ("me_2.csv", "me_2"), ("me.csv", "me")],
)
def test_subject_comes_from_the_file_name_or_the_caller(file, name, subject):
    assert Trace.read(file(HEADER + GOOD, name)).subject == subject
    assert Trace.read(file(HEADER + GOOD, name), subject="anna").subject == "anna"


@pytest.mark.parametrize(
    "content",
    [
        HEADER + GOOD,
        HEADER + GOOD.rstrip("\n"),
        HEADER + GOOD + "\n  \n\n",
        (HEADER + GOOD).replace("\n", "\r\n"),
        (HEADER + GOOD).replace(",", " , "),
        ("\ufeff" + HEADER + GOOD),
        "note,qz,qy,qx,qw,t_s\na,0,0,0,1,0.0\nb b,0,0,.6,.8,1e-1\n#,0,0,.8,6e-1,.2\n",
    ],
    ids=["plain", "no last newline", "blank end", "CRLF", "spaces", "BOM", "columns"],
)
def test_reader_tolerates(file, content):
    trace = Trace.read(file(content))
    np.testing.assert_array_equal(trace.t_s, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(
        trace.world_from_head[:, :2], [[1, 0], [0.8, 0.6], [0.6, 0.8]], rtol=1e-15
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "me.csv: is empty."),
        (" \n\n", "me.csv: is empty."),
        (b"\x00\xff\x10", "me.csv: must be text in UTF-8, but byte 2 is not."),
        (
            "t_s,qw,qx,qy\n0,1,0,0\n",
            "me.csv, line 1, column qz: is missing; the header is 't_s,qw,qx,qy'.",
        ),
        (
            "t_s,qw,qx,qy,qz,qw\n",
            "me.csv, line 1, column qw: appears twice; "
            "the header is 't_s,qw,qx,qy,qz,qw'.",
        ),
        (HEADER, "me.csv: must have at least 2 rows, got 0."),
        (HEADER + "0,1,0,0,0\n", "me.csv: must have at least 2 rows, got 1."),
        (
            HEADER + GOOD + "0.3,1,0,0\n",
            "me.csv, line 5: must have 5 fields like the header, got 4.",
        ),
        (
            HEADER + GOOD + "0.3,1,0,0,0,0\n",
            "me.csv, line 5: must have 5 fields like the header, got 6.",
        ),
        (
            HEADER + "\n" + GOOD,
            "me.csv, line 2: must have 5 fields like the header, got 1.",
        ),
        (
            HEADER + GOOD + "0.3,1,0,zero,0\n",
            "me.csv, line 5, column qy: must be a finite number, got 'zero'.",
        ),
        (
            HEADER + GOOD + "0.3,1,,0,0\n",
            "me.csv, line 5, column qx: must be a finite number, got ''.",
        ),
        (
            HEADER + GOOD + "0.3,1,0,1_0,0\n",
            "me.csv, line 5, column qy: must be a finite number, got '1_0'.",
        ),
        (
            HEADER + GOOD + "0.3,nan,0,0,0\n",
            "me.csv, line 5, column qw: must be a finite number, got 'nan'.",
        ),
        (
            HEADER + "0,1,0,0,0\n1e999,1,0,0,0\n",
            "me.csv, line 3, column t_s: must be a finite number, got '1e999'.",
        ),
        (
            HEADER + GOOD + "0.2,1,0,0,0\n",
            "me.csv, line 5, column t_s: times must rise, got 0.2 after 0.2 "
            "(a duplicate).",
        ),
        (
            HEADER + GOOD + "0.3,0.98,0,0,0\n",
            "me.csv, line 5, columns qw,qx,qy,qz: length must lie within 1 % of 1, "
            "got 0.98.",
        ),
        (
            HEADER + GOOD + "0.3,1e200,0,0,0\n",
            "me.csv, line 5, columns qw,qx,qy,qz: length must lie within 1 % of 1, "
            "got inf.",
        ),
    ],
)
def test_reader_says_what_is_wrong_and_where(file, content, message):
    assert message_of(file(content)) == message


def test_reader_says_why_a_file_cannot_be_read(tmp_path):
    assert message_of(tmp_path / "no.csv").startswith("no.csv: cannot be read (No such")
    assert "cannot be read (Is a directory)" in message_of(tmp_path)


fields = st.sampled_from(["0", "1", "-1", "nan", "1e400", "", '"', "\x00", " ", "0.1"])
rows = st.lists(st.lists(fields, min_size=4, max_size=6).map(",".join), max_size=4)
tables = rows.map(lambda lines: (HEADER + "\n".join(lines)).encode())
contents = st.one_of(
    st.binary(max_size=200),
    st.binary(max_size=60).map(lambda tail: HEADER.encode() + tail),
    st.binary(max_size=10).map(lambda tail: (HEADER + GOOD).encode() + tail),
    tables,
)


@given(contents)
def test_any_bytes_give_a_trace_or_one_clear_line(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz", numbered=True) / "any.csv"
    path.write_bytes(content)
    trace, message = None, "any.csv: is fine"
    try:
        trace = Trace.read(path)
    except ValueError as error:
        message = str(error)
    assert message.startswith("any.csv")
    assert len(message.splitlines()) == 1
    if trace is not None:
        lengths = np.linalg.norm(trace.world_from_head, axis=1)
        np.testing.assert_allclose(lengths, 1.0, rtol=1e-15)
        assert np.all(np.diff(trace.t_s) > 0)


@pytest.mark.slow
def test_a_million_rows_are_read_in_seconds(tmp_path):
    t_s = np.arange(10**6) / 90
    half = 0.01 * np.sin(t_s)
    poses = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    Trace(t_s, poses).write(tmp_path / "long.csv")
    trace = Trace.read(tmp_path / "long.csv")
    np.testing.assert_allclose(trace.world_from_head, poses, atol=4e-16)


# --- the constructor ---


def test_constructor_checks_and_names_the_row():
    t_s, poses = np.arange(3.0), np.tile([1.0, 0, 0, 0], (3, 1))
    with pytest.raises(ValueError, match=r"trace, row 3, column t_s: times must rise"):
        Trace(np.array([0.0, 1.0, 0.5]), poses)
    with pytest.raises(ValueError, match=r"trace, row 2, column qx: .* got nan"):
        Trace(t_s, np.where(np.arange(12).reshape(3, 4) == 5, np.nan, poses))
    with pytest.raises(ValueError, match=r"trace, row 1, columns .* got 2\."):
        Trace(t_s, 2 * poses)
    with pytest.raises(ValueError, match=r"got \(3,\) and \(2, 4\)"):
        Trace(t_s, poses[:2])
    with pytest.raises(ValueError, match="at least 2 rows, got 1"):
        Trace(t_s[:1], poses[:1])


def test_lengths_are_normalised_and_the_callers_arrays_left_alone():
    t_s, poses = np.arange(3.0), 1.009 * np.tile([0.6, 0.8, 0, 0], (3, 1))
    trace = Trace(t_s, poses)
    np.testing.assert_allclose(trace.world_from_head[0], [0.6, 0.8, 0, 0], rtol=1e-15)
    assert poses[0, 0] == 1.009 * 0.6
    with pytest.raises(ValueError, match="read-only"):
        trace.t_s[0] = 1.0


def test_sign_flips_are_repaired(wobble, rng):
    signs = rng.choice([-1.0, 1.0], len(wobble.t_s))
    signs[0] = 1.0
    repaired = Trace(wobble.t_s, signs[:, None] * wobble.world_from_head)
    np.testing.assert_allclose(
        repaired.world_from_head, wobble.world_from_head, rtol=0, atol=4e-16
    )
    neighbours = repaired.world_from_head[1:] * repaired.world_from_head[:-1]
    assert np.all(np.sum(neighbours, axis=1) > 0)


# --- resampling and windows ---


def test_resampling_agrees_with_scipy_slerp(wobble):
    ours = wobble.resample(113.0)
    keyframes = Rotation.from_quat(wobble.world_from_head, scalar_first=True)
    inside = np.clip(ours.t_s, wobble.t_s[0], wobble.t_s[-1])
    oracle = Slerp(wobble.t_s, keyframes)(inside).as_quat(scalar_first=True)
    # Times near 10 s are rounded to 2e-15 s, which turn at up to 60 rad/s.
    assert np.max(angles_between(ours.world_from_head, oracle)) < 1e-12
    np.testing.assert_allclose(np.diff(ours.t_s), 1 / 113.0, rtol=1e-10)
    assert ours.t_s[0] == wobble.t_s[0]
    assert 0 <= wobble.t_s[-1] - ours.t_s[-1] < 1 / 113.0
    assert ours.subject == "p1"


@pytest.mark.parametrize("rate_hz", [60.0, 72.0, 90.0, 1000.0])
def test_a_uniform_trace_resampled_at_its_own_rate_is_itself(wobble, rate_hz):
    uniform = Trace(np.arange(300) / rate_hz, wobble.world_from_head)
    same = uniform.resample(uniform.rate_hz)
    np.testing.assert_allclose(same.t_s, uniform.t_s, atol=1e-12)
    np.testing.assert_allclose(
        same.world_from_head, uniform.world_from_head, atol=1e-12
    )


@pytest.mark.parametrize("step_rad", [0.0, 1e-300, 1e-12, 1e-6, 3.14])
def test_resampling_halves_steps_of_every_size(step_rad):
    half = step_rad / 2
    poses = np.array([[1, 0, 0, 0], [np.cos(half), 0, np.sin(half), 0]])
    middle = Trace(np.array([0.0, 1.0]), poses).resample(2.0).world_from_head[1]
    np.testing.assert_allclose(2 * np.arcsin(middle[2]), half, rtol=1e-12)


def test_rate_and_duration_ignore_lost_frames():
    t_s = np.delete(np.arange(100) / 50, [20, 40, 41])
    trace = Trace(t_s, np.tile([1.0, 0, 0, 0], (97, 1)))
    assert trace.rate_hz == pytest.approx(50.0, rel=1e-12)
    assert trace.duration_s == pytest.approx(1.98, rel=1e-12)


def test_windows_are_consecutive_and_do_not_overlap(wobble):
    uniform = Trace(np.arange(300) / 90, wobble.world_from_head)
    windows = uniform.windows(70)
    assert windows.shape == (4, 70, 4)
    np.testing.assert_array_equal(windows.reshape(-1, 4), uniform.world_from_head[:280])
    assert uniform.windows(300).shape == (1, 300, 4)
    at_45 = uniform.windows(50, 45.0)
    np.testing.assert_allclose(at_45[0], uniform.world_from_head[:100:2], atol=1e-12)


def test_windows_fill_lost_frames():
    t_s = np.arange(100) / 50
    yaw = 0.01 * t_s
    poses = np.stack([np.cos(yaw / 2), 0 * yaw, np.sin(yaw / 2), 0 * yaw], axis=1)
    kept = np.delete(np.arange(100), [20, 40, 41])
    windows = Trace(t_s[kept], poses[kept]).windows(50)
    np.testing.assert_allclose(windows.reshape(-1, 4), poses, atol=1e-12)


def test_resampling_and_windows_refuse_what_cannot_be_done(wobble):
    with pytest.raises(ValueError, match=r"rate_hz must lie in \(0, inf\), got 0\."):
        wobble.resample(0.0)
    with pytest.raises(ValueError, match=r"rate_hz must leave 2 to .* got 0\.01\."):
        wobble.resample(0.01)
    with pytest.raises(ValueError, match=r"rate_hz must leave 2 to .* got 1e\+12\."):
        wobble.resample(1e12)
    with pytest.raises(ValueError, match=r"frames must be at most .* got 10000\."):
        wobble.windows(10000)
    with pytest.raises(ValueError, match=r"frames must be a whole number >= 2, got 1"):
        wobble.windows(1)


# --- frames and gaps ---


def yawing(t_s, speed_deg_s=1.0, **names):
    """A head that turns at a constant speed about the upward axis."""
    half = np.radians(speed_deg_s * np.asarray(t_s)) / 2
    poses = np.stack([np.cos(half), 0 * half, np.sin(half), 0 * half], axis=1)
    return Trace(np.asarray(t_s), poses, **names)


frame_steps = st.lists(st.sampled_from([1, 1, 1, 2, 3]), min_size=4, max_size=60)


@given(frame_steps, st.floats(20, 1000), st.integers(0, 2**32 - 1))
def test_frames_are_counted_through_losses_and_jitter(steps, rate_hz, seed):
    # Mostly whole steps, so that the median one is a frame.
    frames = np.cumsum([0, 1, *steps, *np.ones(len(steps), int)])
    # A step moves by two jitters and the median by two: 0.05 (2 + 3 * 2) < 0.5.
    jitter = np.random.default_rng(seed).uniform(-0.05, 0.05, len(frames))
    trace = yawing((frames + jitter) / rate_hz)
    np.testing.assert_array_equal(trace.frame_numbers, frames)
    assert trace.rate_hz == pytest.approx(rate_hz, rel=0.11 / frames[-1])


def test_rate_is_right_where_times_are_rounded():
    trace = yawing(np.round(np.arange(600) / 59.8, 3))
    assert trace.frame_s == pytest.approx(0.017)
    assert trace.rate_hz == pytest.approx(59.8, rel=1e-3 / trace.duration_s)


def test_a_late_row_keeps_its_frame():
    trace = yawing(np.array([0.0, 1.0, 2.0, 3.9, 4.0, 5.0, 6.0]) / 90)
    np.testing.assert_array_equal(trace.frame_numbers, np.arange(7))
    assert trace.rate_hz == pytest.approx(90)


def test_frames_are_counted_on_across_gaps_but_not_in_the_rate():
    frames = np.concatenate([np.arange(50), np.arange(74, 120), [2000]])
    trace = yawing(7 + (frames + 0.4 * (frames > 60)) / 72)
    np.testing.assert_array_equal(trace.frame_numbers, frames)
    assert trace.rate_hz == pytest.approx(72)
    huge = yawing([0.0, 0.01, 0.02, 1e90])
    assert huge.frame_numbers[-1] > 10**7
    assert huge.rate_hz == pytest.approx(100)


@pytest.mark.parametrize(("step", "is_gap"), [(2, False), (3, False), (4, True)])
def test_parts_lie_between_gaps_as_recorded(step, is_gap):
    frames = np.cumsum([0, *[1] * 20, step, *[1] * 30])
    whole = yawing(3 + frames / 90, subject="anna", name="a.csv")
    parts = whole.parts()
    assert len(parts) == 1 + is_gap
    np.testing.assert_array_equal(np.concatenate([p.t_s for p in parts]), whole.t_s)
    rows = np.concatenate([part.world_from_head for part in parts])
    np.testing.assert_array_equal(rows, whole.world_from_head)
    assert {(p.subject, p.name, p.frame_s) for p in parts} == {
        ("anna", "a.csv", whole.frame_s)
    }


def test_rows_alone_between_gaps_are_no_part():
    trace = yawing([0.0, 1.0, 1.01, 1.02, 1.03, 1.04, 2.0, 3.0, 3.01, 4.0])
    assert [part.t_s.tolist() for part in trace.parts()] == [
        [1.0, 1.01, 1.02, 1.03, 1.04],
        [3.0, 3.01],
    ]


def test_a_part_counts_frames_as_the_whole_does():
    # The second part lost every other frame: by itself it would seem half as fast.
    frames = np.concatenate([np.arange(90), 200 + 2 * np.arange(30)])
    whole = yawing(frames / 90)
    assert whole.parts()[1].rate_hz == pytest.approx(90)
    again = whole.parts()[1].resample(90.0)
    np.testing.assert_allclose(again.t_s, np.arange(200, 259) / 90, rtol=1e-12)


def test_resampling_refuses_gaps_and_fills_two_lost_frames():
    frames = np.delete(np.arange(100), [20, 40, 41, *range(60, 63)])
    trace = yawing(frames / 50)
    message = r"trace: .* got one of 0\.08 s at 1\.18 s; resample its parts\(\)\."
    with pytest.raises(ValueError, match=message):
        trace.resample(50.0)
    first, second = (part.resample(50.0) for part in trace.parts())
    filled = yawing(np.concatenate([np.arange(60), np.arange(63, 100)]) / 50)
    ours = np.concatenate([first.world_from_head, second.world_from_head])
    np.testing.assert_allclose(ours, filled.world_from_head, atol=1e-14)


@pytest.mark.parametrize("rate_hz", [None, 50.0, 25.0])
def test_windows_hold_no_gap(rate_hz):
    frames = np.concatenate([np.arange(47), 80 + np.arange(5), 200 + np.arange(63)])
    trace = yawing(frames / 50)
    windows = trace.windows(10, rate_hz)
    shown_hz = rate_hz or 50.0
    steps = angles_between(
        windows[:, :-1].reshape(-1, 4), windows[:, 1:].reshape(-1, 4)
    )
    np.testing.assert_allclose(np.degrees(steps), 1 / shown_hz, rtol=1e-9)
    assert len(windows) == (4 + 6 if shown_hz == 50 else 2 + 3)
    longest = 63 if shown_hz == 50 else 32
    with pytest.raises(ValueError, match=rf"at most the {longest} without a gap of"):
        trace.windows(64, rate_hz)


# --- still segments ---


def test_still_segments_lie_where_the_head_is_still():
    speed = np.repeat([0.5, 40.0, 1.0, 40.0, 0.5], [450, 90, 300, 90, 90])
    angle = np.cumsum(speed) / 90
    half = np.radians(angle) / 2
    poses = np.stack([np.cos(half), np.sin(half), 0 * half, 0 * half], axis=1)
    trace = Trace(100 + np.arange(len(speed)) / 90, poses, subject="anna")
    segments = trace.still_segments()
    # Of the window's 45 frames, a share s at 40 deg/s is still while 40 sqrt(s) < 5, up
    # to 0.7 frames. The turns last from row 449 to 539, and again from row 839: so the
    # last row before is 449.7 - 22.5, the first one after 538.3 + 22.5.
    assert [len(segment.t_s) for segment in segments] == [428, 817 - 561 + 1]
    np.testing.assert_array_equal(segments[0].t_s, trace.t_s[:428])
    assert segments[1].t_s[0] == 100 + 561 / 90
    assert segments[1].subject == "anna"
    assert len(trace.still_segments(min_duration_s=0.5)) == 3
    assert trace.still_segments(min_duration_s=5.0) == []
    assert len(trace.still_segments(max_speed_deg_s=0.7)) == 1
    (everything,) = trace.still_segments(max_speed_deg_s=41.0)
    assert len(everything.t_s) == len(trace.t_s)


def test_speed_limit_and_duration_are_met_exactly():
    trace = yawing(np.arange(181) / 90, speed_deg_s=5.0)
    assert len(trace.still_segments(5.001, 2.0)) == 1
    assert trace.still_segments(5.001, 2.001) == []
    assert trace.still_segments(4.999, 2.0) == []
    for wrong in ({"max_speed_deg_s": 0.0}, {"min_duration_s": -1.0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} must lie in"):
            trace.still_segments(**wrong)


def test_still_segments_hold_no_gap_and_allow_lost_frames():
    frames = np.delete(np.arange(900), [100, 200, 201, *range(400, 410)])
    segments = yawing(frames / 90).still_segments()
    assert [len(segment.t_s) for segment in segments] == [397, 490]
    assert segments[1].t_s[0] == 410 / 90


@pytest.mark.parametrize("turn", [4.9, 5.1])
def test_speed_does_not_depend_on_which_frames_are_lost(rng, turn):
    kept = np.sort(rng.permutation(900)[:650])
    kept = np.concatenate([[0], kept[(kept > 0) & (kept < 899)], [899]])
    gaps = np.flatnonzero(np.diff(kept) > 3)
    trace = yawing(np.delete(kept, gaps) / 90, turn)
    found = sum(len(s.t_s) for s in trace.still_segments(5.0, 0.005))
    assert found == (sum(len(p.t_s) for p in trace.parts()) if turn < 5 else 0)


def joined(*traces_and_starts):
    t_s = np.concatenate([trace.t_s + start for trace, start in traces_and_starts])
    poses = np.concatenate([trace.world_from_head for trace, _ in traces_and_starts])
    return Trace(t_s, poses)


@pytest.mark.parametrize(
    ("still", "parts", "start_s", "duration_s"),
    [
        ("nas_WDRIB9_20_still", {"nas_WDRIB9_20_whole": 0.0}, 24.47, 12.08),
        (
            "crom_p26_t103_still",
            {"crom_p26_t103_whole_part2": 60.0, "crom_p26_t103_whole_part3": 120.0},
            117.48,
            26.19,
        ),
    ],
)
def test_still_segments_find_the_ones_cut_by_others(
    shared, still, parts, start_s, duration_s
):
    folder = Path(shared) / "traces"
    read = lambda name: Trace.read(folder / f"{name}.csv")
    whole = joined(*((read(name), start) for name, start in parts.items()))
    longest = max(whole.still_segments(), key=lambda segment: segment.duration_s)
    # The table rounds to 0.01 s; their window counts rows, ours is 0.5 s long, so that
    # a row more or less may be within the limit at each end.
    tolerance_s = 0.005 + 1 / whole.rate_hz
    assert longest.t_s[0] == pytest.approx(start_s, abs=tolerance_s)
    assert longest.t_s[-1] == pytest.approx(start_s + duration_s, abs=2 * tolerance_s)
    # The file of the still run holds the same rows.
    cut = read(still)
    first = np.argmin(np.abs(whole.t_s - start_s))
    same = whole.world_from_head[first : first + len(cut.t_s)]
    assert np.max(angles_between(cut.world_from_head, same)) < 1e-6


def test_still_recordings_are_still(shared):
    for path in sorted((Path(shared) / "traces").glob("*_still.csv")):
        trace = Trace.read(path)
        longest_s = max(segment.duration_s for segment in trace.still_segments())
        # At the ends of the file the window is cut, so half a window may be lost there.
        assert longest_s > trace.duration_s - 0.5
        assert max(len(part.t_s) for part in trace.parts()) == len(trace.t_s)


# --- recorded traces ---


def test_recorded_traces_have_the_rate_and_speed_of_their_table(shared):
    folder = Path(shared) / "traces"
    table = re.findall(
        r"^\| (\w+\.csv) \|.*\| (\d+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| [\d.]+ \|",
        (folder / "README.md").read_text(),
        re.MULTILINE,
    )
    assert len(table) == len(list(folder.glob("*.csv"))) > 20
    for name, rows, duration_s, mean_rate_hz, rms_deg_s in table:
        trace = Trace.read(folder / name)
        assert len(trace.t_s) == int(rows)
        assert trace.subject == "_".join(name.removesuffix(".csv").split("_")[:2])
        assert trace.duration_s == pytest.approx(float(duration_s), abs=0.011)
        rate_hz = (int(rows) - 1) / trace.duration_s
        assert rate_hz == pytest.approx(float(mean_rate_hz), abs=0.051)
        # By the README; nas_YHN1WZ_19 jitters by half a frame, which counts as lost.
        kind = name.split("_")[0]
        nominal_hz = {"crom": 90.0, "fix": 90.0, "static": 72.0, "nas": 59.8}[kind]
        within = 8e-3 if kind == "nas" else 1e-5
        assert trace.rate_hz == pytest.approx(nominal_hz, rel=within)
        turned_rad = angles_between(
            trace.world_from_head[:-1], trace.world_from_head[1:]
        )
        speed = np.degrees(turned_rad) / np.diff(trace.t_s)
        rms = np.sqrt(np.mean(speed**2))
        # The table rounds to 2 decimals; times in the files round to 1e-5 s.
        assert rms == pytest.approx(float(rms_deg_s), rel=2e-3, abs=0.006)


# --- rounded times ---


def test_lost_frames_of_a_short_log_are_not_taken_for_rounded_times(rng):
    for _ in range(50):
        kept = np.sort(rng.permutation(np.arange(1, 29))[3:])
        t_s = np.concatenate([[0], kept, [29]]) / 90
        assert yawing(t_s).rate_hz == pytest.approx(90.0, rel=1e-9)


@pytest.mark.parametrize(
    ("rate_hz", "tick_s", "rows"),
    [
        (90.0, 0.01, 600),
        (90.0, 0.01, 22),
        (90.0, 0.005, 600),
        (60.0, 1 / 64, 600),
        (60.0, 0.0156, 600),
        (60.0, 0.0156, 30),
        (60.0, 1 / 64, 30),
        (59.94, 0.0156, 30),
        (72.0, 0.01, 300),
        (62.0, 0.01, 600),
        (98.0, 0.01, 900),
    ],
)
@pytest.mark.parametrize("rounding", [np.round, np.floor])
def test_rows_are_counted_where_times_are_rounded(rate_hz, tick_s, rows, rounding):
    t_s = tick_s * rounding(np.arange(rows) / rate_hz / tick_s + 1e-9)
    trace = yawing(t_s)
    assert trace.rate_hz == pytest.approx((rows - 1) / trace.duration_s, rel=1e-12)
    assert trace.rate_hz == pytest.approx(rate_hz, rel=1.5 / rows)
    np.testing.assert_array_equal(trace.frame_numbers, np.arange(rows))
    # Rows are replayed as they are, and resampled at the times that they had.
    np.testing.assert_array_equal(trace.windows(rows)[0], trace.world_from_head)
    again = trace.resample(trace.rate_hz).world_from_head
    np.testing.assert_allclose(again, trace.world_from_head, atol=1e-9)


def test_a_frame_lost_among_rounded_times_is_counted():
    frames = np.delete(np.arange(3000), [700, 1500, *range(2000, 2005)])
    trace = yawing(np.round(7 + frames / 90, 2))
    assert np.max(np.abs(trace.frame_numbers - frames)) <= 1
    assert trace.rate_hz == pytest.approx(90, rel=1e-3)
    assert "rounded" in trace.notes[0]


def test_many_lost_frames_are_no_rounded_times(rng):
    # 60 frames a second on a display of 90 Hz, and a third of them lost at random.
    frames = np.cumsum(rng.choice([1, 2], 2000, p=[0.6, 0.4]))
    trace = yawing(frames / 90)
    assert trace.rate_hz == pytest.approx(90, rel=1e-9)
    assert trace.notes == ()


@pytest.mark.parametrize(("scale", "rate"), [(1e3, "0.09"), (1e-3, "90000")])
def test_a_rate_that_no_display_has_is_an_error_wherever_it_is_taken(scale, rate):
    trace = yawing(scale * np.arange(100) / 90, name="me.csv")
    message = (
        rf"me.csv: frame rate must lie in \[5, 2000\] Hz, got {re.escape(rate)} Hz"
    )
    for take in (
        lambda: trace.rate_hz,
        lambda: trace.windows(10),
        lambda: trace.still_segments(),
        lambda: hj.Replay([trace]),
        lambda: hj.Replay([trace], rate_hz=90.0),
        lambda: hj.fit_heads([trace]),
    ):
        with pytest.raises(ValueError, match=message):
            take()


# --- held poses ---


def held(trace, of_rows, at_rows):
    """Poses of a slower tracker: of these rows, each held until the next one's time."""
    last = np.searchsorted(at_rows, np.arange(len(trace.t_s)), side="right") - 1
    return Trace(trace.t_s, trace.world_from_head[of_rows[last]], name="me.csv")


@pytest.mark.parametrize("tracker_hz", [30.0, 45.0, 72.0, 80.0])
def test_held_poses_are_told_and_left_out(tracker_hz):
    whole = yawing(np.arange(901) / 90)
    new = np.ceil(np.arange(901) * 90 / tracker_hz - 1e-9).astype(int)
    new = new[new <= 900]
    trace = held(whole, new, new)
    repeats = 901 - len(new)
    (note,) = trace.notes
    assert f"me.csv: poses are held: {repeats} of 901 rows repeat the pose" in note
    assert f"new ones come at {tracker_hz:g} Hz" in note
    renewed = trace.without_held()
    assert renewed.rate_hz == pytest.approx(tracker_hz, rel=2e-3)
    np.testing.assert_array_equal(renewed.world_from_head, whole.world_from_head[new])
    assert f"left out {repeats} of 901 rows as held" in renewed.notes[0]
    assert not any("poses are held" in note for note in renewed.notes)
    assert hj.Replay([renewed]).refresh_hz == renewed.rate_hz


@pytest.mark.parametrize(("rows", "repeated"), [(8, 2), (18, 2), (30, 6)])
def test_held_poses_of_short_clips_are_told(rows, repeated):
    whole = yawing(np.arange(rows) / 90)
    is_new = np.arange(rows) % repeated != repeated - 1
    new = np.flatnonzero(is_new)
    assert "poses are held" in held(whole, new, new).notes[-1]


def test_few_equal_poses_are_not_held_ones():
    whole = yawing(np.arange(901) / 90)
    rows = np.arange(901)
    rows[::30] = np.maximum(rows[::30] - 1, 0)
    assert held(whole, rows, np.arange(901)).notes == ()
    still = Trace(whole.t_s, np.tile([1.0, 0, 0, 0], (901, 1)), name="me.csv")
    assert still.notes == ("me.csv: the pose never changes.",)
    with pytest.raises(ValueError, match="poses must change to be told from held"):
        still.without_held()


def test_reading_warns_of_held_poses_but_not_of_what_is_left_out(tmp_path):
    whole = yawing(np.arange(91) / 90)
    held(whole, np.arange(0, 91, 2), np.arange(0, 91, 2)).write(tmp_path / "me.csv")
    with pytest.warns(UserWarning, match="poses are held: 45 of 91 rows"):
        trace = Trace.read(tmp_path / "me.csv")
    assert trace.rate_hz == pytest.approx(90)
    assert Trace.read(tmp_path / "me.csv", skip_held=True).rate_hz == pytest.approx(45)
