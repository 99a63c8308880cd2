import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from hmdjit.head_motion import Trace

HEADER = "t_s,qw,qx,qy,qz\n"
GOOD = "0.0,1,0,0,0\n0.1,0.8,0.6,0,0\n0.2,0.6,0.8,0,0\n"


@pytest.fixture
def file(tmp_path):
    def write(content, name="me.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


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
            "me.csv, line 5, column t_s: times must rise, got 0.2 after 0.2.",
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
        if not name.startswith("fix"):  # which loses 30 % of its frames
            assert trace.rate_hz == pytest.approx(rate_hz, rel=0.05)
        turned_rad = angles_between(
            trace.world_from_head[:-1], trace.world_from_head[1:]
        )
        speed = np.degrees(turned_rad) / np.diff(trace.t_s)
        rms = np.sqrt(np.mean(speed**2))
        # The table rounds to 2 decimals; times in the files round to 1e-5 s.
        assert rms == pytest.approx(float(rms_deg_s), rel=2e-3, abs=0.006)
