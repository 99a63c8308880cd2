import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hmdjit.head_motion import Trace

T_S = np.array([0.0, 0.01, 0.02, 0.035, 0.05])
TURNS = Rotation.from_rotvec(
    np.array([[0, 0, 0], [0.1, 0.2, -0.3], [0.2, 0.3, -0.3], [1, 0, 2], [1, 0.2, 2]])
)
WXYZ = TURNS.as_quat(scalar_first=True)
MIRROR = np.diag([1.0, 1.0, -1.0])


def table(header, columns, separator=",", comma=False):
    lines = [separator.join(header)]
    for row in np.column_stack(columns).tolist():
        fields = [repr(value).replace(".", "," if comma else ".") for value in row]
        lines.append(separator.join(fields))
    return "\n".join(lines) + "\n"


def log(entries):
    return "\n".join(map(json.dumps, entries)) + "\n"


def plain_log(orientation, time="time"):
    rows = zip(T_S.tolist(), WXYZ.tolist(), strict=True)
    return log([{time: t, **orientation(*wxyz)} for t, wxyz in rows])


def by_name(w, x, y, z):
    return {"x": x, "y": y, "z": z, "w": w}


def assert_is_the_sample(trace, orientations=TURNS):
    np.testing.assert_allclose(trace.t_s - trace.t_s[0], T_S, rtol=0, atol=1e-15)
    ours = Rotation.from_quat(trace.world_from_head, scalar_first=True)
    # A few roundings of entries up to 1.
    assert np.max((ours.inv() * orientations).magnitude()) < 1e-14


NAMES = ["t_s", "qw", "qx", "qy", "qz"]
SAMPLE = table(NAMES, [T_S, WXYZ])


# --- what is understood ---


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("separator", [";", "\t", " ", "   ", " \t "])
def test_separators_and_decimal_commas_are_detected(file, separator, comma):
    text = table(NAMES, [T_S, WXYZ], separator, comma)
    assert_is_the_sample(Trace.read(file(text)))
    columns = ("time", "qw", "qx", "qy", "qz")
    without_header = text.split("\n", 1)[1]
    assert_is_the_sample(Trace.read(file(without_header), columns=columns))


@pytest.mark.parametrize(
    "text",
    [
        SAMPLE.replace("\n", "\r\n"),
        SAMPLE.replace("\n", "\r"),
        "\ufeff" + SAMPLE + "\n \n\n",
        "# made by hand\n\n  # in two lines\n" + SAMPLE,
        "# made by hand\n# " + SAMPLE,
        "# " + table(NAMES, [T_S, WXYZ], " "),
        re.sub(r"[^,\n]+", r'"\g<0>"', SAMPLE),
        re.sub(r"[-\d]+\.[-\de]+", lambda n: f'"{n[0].replace(".", ",")}"', SAMPLE),
        SAMPLE.upper(),
        re.sub(r"(?m)^", "a note,", SAMPLE.strip()),
        re.sub(r"(?m)^", '"a, b; c",', SAMPLE.strip()),
        re.sub(r"(?m)^", "7,", SAMPLE.strip()).replace("7", "", 1),
    ],
    ids=[
        "CRLF",
        "CR",
        "BOM and blank end",
        "comments",
        "header in a comment",
        "header in a comment, blanks",
        "quotes",
        "quoted decimal commas",
        "upper case",
        "more columns",
        "quoted separators",
        "index without a name",
    ],
)
def test_reader_tolerates(file, text):
    assert_is_the_sample(Trace.read(file(text)))


@pytest.mark.parametrize(
    "header",
    [
        "t,w,x,y,z",
        "Time,qW,qX,qY,qZ",
        "TimeStamp (s),rot_w,rot_x,rot_y,rot_z",
        "time [s],rotation_w,rotation_x,rotation_y,rotation_z",
        "seconds,orientation.w,orientation.x,orientation.y,orientation.z",
        "elapsed.s,Quat W,Quat X,Quat Y,Quat Z",
        "timestamp,q_w,q_x,q_y,q_z",
        "ts,HMD.qW,HMD.qX,HMD.qY,HMD.qZ",
        "time_sec,head_rotation_w,head_rotation_x,head_rotation_y,head_rotation_z",
        "t_s,rotW,rotX,rotY,rotZ",
        "xrTime,qw [-],qx [-],qy [-],qz [-]",
    ],
)
def test_names_of_columns_are_understood_in_any_order(file, header):
    names = header.split(",")
    order = [3, 1, 4, 0, 2]  # x, y, z before w, as many files have it
    shuffled = table(
        [names[i] for i in order], [np.column_stack([T_S, WXYZ])[:, order]]
    )
    assert_is_the_sample(Trace.read(file(shuffled)))
    # Positions beside the orientation are not part of it.
    place = table([*names, "pos_x", "pos_y", "pos_z"], [T_S, WXYZ, 9 * WXYZ[:, 1:]])
    assert_is_the_sample(Trace.read(file(place)))


def test_bare_positions_are_told_from_quaternions(file):
    names = ["timestamp", "x", "y", "z", "qx", "qy", "qz", "qw"]
    text = table(names, [T_S, 9 * WXYZ[:, 1:], WXYZ[:, [1, 2, 3, 0]]], " ")
    assert_is_the_sample(Trace.read(file(text)))


def test_columns_name_what_a_header_does_not(file):
    rows = np.column_stack([WXYZ[:, 1:], 7 * T_S, WXYZ[:, 0], T_S])
    columns = ("qx", "qy", "qz", "-", "qw", "time")
    for header in (["a", "b", "c", "d", "e", "f"], ["qz", "qy", "qx", "t", "qw", "y"]):
        text = table(header, [rows])
        assert_is_the_sample(Trace.read(file(text), columns=columns))
        assert_is_the_sample(Trace.read(file(text.split("\n", 1)[1]), columns=columns))
    blank = ("qx", "qy", "qz", "", "qw", "t_s")
    assert_is_the_sample(Trace.read(file(text), columns=blank))


@pytest.mark.parametrize(
    "orientation",
    [
        by_name,
        lambda *wxyz: {"orientation": by_name(*wxyz)},
        lambda w, x, y, z: {"orientation": [x, y, z, w]},
        lambda *wxyz: {"pose": {"orientation": by_name(*wxyz), "position": [1, 2, 3]}},
        lambda w, *xyz: {
            "head": {"pose": {"rotation": [*xyz, w]}},
            "fov": [1, 2, 3, 4],
        },
        lambda *wxyz: {"view": {"pose": {"q": by_name(*wxyz), "p": {"x": 1, "y": 2}}}},
        lambda *wxyz: {"views": [{"pose": {"orientation": by_name(*wxyz)}}]},
        lambda w, x, y, z: {"qx": x, "qy": y, "qz": z, "qw": w, "note": None},
    ],
)
@pytest.mark.parametrize("time", ["time", "t_s", "xrTime"])
def test_logs_hold_the_pose_at_any_depth(file, orientation, time):
    text = plain_log(orientation, time)
    assert_is_the_sample(Trace.read(file(text, "me.jsonl")))
    assert_is_the_sample(Trace.read(file(text.replace("\n", "\r\n") + "\n\n")))


def test_columns_choose_among_the_keys_of_a_log(file):
    names = [f"left.orientation.{part}" for part in "xyzw"]
    text = plain_log(
        lambda *wxyz: {
            "left": {"orientation": by_name(*wxyz)},
            "right": {"orientation": by_name(1, 0, 0, 0)},
        }
    )
    assert_is_the_sample(Trace.read(file(text), columns=("time", *names)))
    message = message_of(file(text))
    assert "left.orientation.w and right.orientation.w: either" in message


# --- angles and axes ---


def euler_deg(rng, rows=50):
    pitch, yaw, roll = rng.uniform(-180, 180, (3, rows))
    return {"pitch": pitch, "yaw": yaw, "roll": roll}


@pytest.mark.parametrize(
    "names",
    [
        ["time", "pitch", "yaw", "roll"],
        ["time", "roll_deg", "pitch_deg", "yaw_deg"],
        ["Time (s)", "Head Yaw [deg]", "Head Pitch [deg]", "Head Roll [deg]"],
    ],
)
def test_euler_angles_agree_with_scipy(file, rng, names):
    angles = euler_deg(rng)
    order = [
        next(part for part in angles if part in name.lower()) for name in names[1:]
    ]
    t_s = np.arange(50) / 90
    text = table(names, [t_s, *(angles[part] for part in order)])
    head = np.column_stack([angles["yaw"], angles["pitch"], angles["roll"]])
    # Capital letters: about the axes that the turns before have turned.
    oracle = Rotation.from_euler("YXZ", head, degrees=True)
    for axes, expected in [
        ("openxr", oracle.as_matrix()),
        ("unity", MIRROR @ oracle.as_matrix() @ MIRROR),
    ]:
        trace = Trace.read(file(text), axes=axes)
        ours = Rotation.from_quat(trace.world_from_head, scalar_first=True)
        np.testing.assert_allclose(ours.as_matrix(), expected, atol=1e-14)


def test_a_turn_to_the_left_has_the_same_sense_in_both_axes(file):
    # Unity's yaw is positive to the right, as y is up and it is left-handed.
    text = table(
        ["time", "pitch", "yaw", "roll"], [[0.0, 0.1], [0, 0], [0, 30], [0, 0]]
    )
    left = Trace.read(file(text)).world_from_head[1]
    right = Trace.read(file(text), axes="unity").world_from_head[1]
    np.testing.assert_allclose(left, [np.cos(np.pi / 12), 0, np.sin(np.pi / 12), 0])
    np.testing.assert_allclose(right, left * [1, -1, -1, 1])


def test_unity_axes_are_mirrored(file):
    trace = Trace.read(file(SAMPLE), axes="unity")
    mirrored = Rotation.from_matrix(MIRROR @ TURNS.as_matrix() @ MIRROR)
    assert_is_the_sample(trace, mirrored)
    forward = trace.world_from_head[:, 0]  # the angle stays
    np.testing.assert_allclose(np.abs(forward), np.abs(WXYZ[:, 0]), atol=1e-15)


# --- times ---


PER_S = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}


@pytest.mark.parametrize("rate_hz", [5.01, 59.94, 90.0, 1000.0, 1999.0])
@pytest.mark.parametrize("unit", PER_S)
def test_the_unit_of_time_is_detected_or_named(file, unit, rate_hz):
    t_s = 3.0 + np.arange(20) / rate_hz
    rows = np.tile([1.0, 0, 0, 0], (20, 1))
    names = ["time", f"time_{unit}", f"t_{unit}", f"Timestamp [{unit}]"]
    for name in names:
        text = table([name, "w", "x", "y", "z"], [t_s * PER_S[unit], rows])
        trace = Trace.read(file(text))
        expected = t_s if unit == "s" else t_s - t_s[0]
        np.testing.assert_allclose(trace.t_s, expected, rtol=1e-12, atol=1e-12)
        named = Trace.read(file(text), time_unit=unit)
        np.testing.assert_array_equal(named.t_s, trace.t_s)


@pytest.mark.parametrize(("name", "unit"), [("t_s", "s"), ("time_ms", "ms")])
def test_a_unit_that_is_named_is_not_reinterpreted(file, name, unit):
    for step in (1e-6, 0.01, 30.0, 1e7):
        rows = np.tile([1.0, 0, 0, 0], (4, 1))
        text = table([name, "w", "x", "y", "z"], [step * np.arange(4), rows])
        expected = step * np.arange(4) / PER_S[unit]
        np.testing.assert_allclose(Trace.read(file(text)).t_s, expected, rtol=1e-15)
        in_us = Trace.read(file(text), time_unit="us").t_s
        np.testing.assert_allclose(in_us, step * np.arange(4) / 1e6, rtol=1e-15)


@pytest.mark.parametrize("step", [1e-6, 4.9e-4, 0.3, 300.0, 3e5, 1e12])
def test_an_ambiguous_unit_is_refused(file, step):
    rows = np.tile([1.0, 0, 0, 0], (4, 1))
    text = table(["time", "w", "x", "y", "z"], [step * np.arange(4), rows])
    message = message_of(file(text))
    assert message.startswith("me.csv, line 2, column time: the median step")
    assert "option time_unit, --time-unit (s, ms, us, ns)" in message
    trace = Trace.read(file(text), time_unit="s")
    np.testing.assert_allclose(trace.t_s, step * np.arange(4))


@pytest.mark.parametrize("first", [0, 1_700_000_000_000_000_000, 2**63 - 10**9])
def test_nanoseconds_keep_their_digits(file, first):
    steps_ns = [0, 11_111_111, 22_222_223, 33_333_334, 33_333_335]
    stamps = [first + step for step in steps_ns]
    lines = [f"{stamp},1,0,0,0" for stamp in stamps]
    csv = "\n".join(["timestamp,qw,qx,qy,qz", *lines])
    entries = [{"xrTime": stamp, "orientation": [0, 0, 0, 1]} for stamp in stamps]
    for text in (csv, csv.replace(",", ";"), log(entries)):
        trace = Trace.read(file(text))
        np.testing.assert_array_equal(trace.t_s, np.array(steps_ns) / 1e9)


def test_fractions_of_long_stamps_keep_their_digits(file):
    lines = [f"1700000000000000{k}.25 1 0 0 0" for k in range(1, 8)]
    trace = Trace.read(file("\n".join(["time_us qw qx qy qz", *lines])))
    np.testing.assert_array_equal(trace.t_s, np.arange(7) / 1e6)


# --- what is refused ---


def message_of(path, **options):
    with pytest.raises(ValueError, match=r"\S") as caught:
        Trace.read(path, **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


ROWS = "0.0,1,0,0,0\n0.1,0.8,0.6,0,0\n0.2,0.6,0.8,0,0\n"
GOOD = "t_s,qw,qx,qy,qz\n" + ROWS
LOG = '{"time": 0.1, "q": [0, 0, 0, 1]}\n{"time": 0.2, "q": [0, 0, 0, 1]}\n'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04\x9c\x00\x00", "must be text in UTF-8, but byte 5 is not."),
        (GOOD.encode("utf-16"), "must be text in UTF-8, but byte 1 is not."),
        (b"\x00\x01\x02", r"line 1, column t_s: is missing; the header is "
         r"'\x00\x01\x02'."),
        ("# only\n# comments\n\n", "is empty."),
        (ROWS, "line 1, column t_s: is missing; the header is '0.0,1,0,0,0'."),
        ("time,a,b\n1,2,3\n", "line 1, column qw: is missing; the header is "
         "'time,a,b'."),
        ("qw,qx,qy,qz\n1,0,0,0\n", "line 1, column t_s: is missing; the header is "
         "'qw,qx,qy,qz'."),
        ("t,yaw,pitch\n0,1,2\n", "line 1, column roll: is missing; the header is "
         "'t,yaw,pitch'."),
        ("t,x,y,z,qx,qy,qz\n0,1,2\n", "line 1, column qw: is missing; the header is "
         "'t,x,y,z,qx,qy,qz'."),
        ("t,yaw_rad,pitch_deg,roll_rad\n", "line 1, column pitch: is missing; the "
         "header is 't,yaw_rad,pitch_deg,roll_rad'."),
        ("t_s,time,qw,qx,qy,qz\n", "line 1, columns t_s and time: either could be "
         "meant; choose by the option columns."),
        ("t,qw,qx,qy,qz,Q_W\n", "line 1, columns qw and Q_W: either could be meant; "
         "choose by the option columns."),
        ("t,qw,qx,qy,qz,pitch,yaw,roll\n", "line 1, columns qw and pitch: either could "
         "be meant; choose by the option columns."),
        ("t,A.qw,A.qx,A.qy,A.qz,B.qw,B.qx,B.qy,B.qz\n", "line 1, columns A.qw and "
         "B.qw: either could be meant; choose by the option columns."),
        ("t,yaw,pitch,roll,yaw\n", "line 1, column yaw: appears twice; the header is "
         "'t,yaw,pitch,roll,yaw'."),
        ("# a\n" + GOOD + "0.3,1,0,0\n", "line 6: must have 5 fields like the header, "
         "got 4."),
        (GOOD + "0.3;1;0;0;0\n", "line 5: must have 5 fields like the header, got 1."),
        (GOOD.replace(",", ";") + "0.3,1,0,0,0\n", "line 5: must have 5 fields like "
         "the header, got 1."),
        (GOOD.replace(",", " ") + "\n0.3 1 0 0 0\n", "line 5: must have 5 fields like "
         "the header, got 1."),
        (GOOD + "0,3,1,0,0,0\n", "line 5: must have 5 fields like the header, got 6."),
        (GOOD.replace(",", ";") + "0.3;1.000,5;0;0;0\n", "line 5, column qw: must be a "
         "finite number, got '1.000.5'."),
        (GOOD.replace(",", "\t") + "0.3\t1\t\t0\t0\n", "line 5, column qx: must be a "
         "finite number, got ''."),
        (GOOD + "0.3,1,0,0,Infinity\n", "line 5, column qz: must be a finite number, "
         "got 'Infinity'."),
        (GOOD + '0.3,1,0,"0,0\n', "line 5, column qy: must be a finite number, got "
         "'\"0'."),
        ("t,yaw,pitch,roll\n0,1,2,3\n0.1,nan,2,3\n", "line 3, column yaw: must be a "
         "finite number, got 'nan'."),
        ("Time,Rot W,Rot X,Rot Y,Rot Z\n0,1,0,0,0\n0.1,0,0,0,0\n", "line 3, columns "
         "Rot W,Rot X,Rot Y,Rot Z: length must lie within 1 % of 1, got 0."),
        (GOOD + "0.2,1,0,0,0\n", "line 5, column t_s: times must rise, got 0.2 after "
         "0.2 (a duplicate)."),
        (GOOD + "0.15,1,0,0,0\n", "line 5, column t_s: times must rise, got 0.15 after "
         "0.2."),
        ("time_ns,w,x,y,z\n1700000000000000001,1,0,0,0\n1700000000000000000,1,0,0,0\n",
         "line 3, column time_ns: times must rise, got 1700000000000000000 after "
         "1700000000000000001."),
        ("time,w,x,y,z\n1700000000000000001,1,0,0,0\n1700000000000000001,1,0,0,0\n",
         "line 3, column time: times must rise, got 1700000000000000001 after "
         "1700000000000000001 (a duplicate)."),
        ("time,w,x,y,z\n2024-01-01T10:00:00,1,0,0,0\n", "line 2, column time: must be "
         "a finite number, got '2024-01-01T10:00:00'."),
        ("time,yaw,pitch,roll\n", "must have at least 2 rows, got 0."),
        ("time,yaw,pitch,roll\n0,1,2,3\n", "must have at least 2 rows, got 1."),
        ("{\n", "line 1: must be a JSON object, got '{'."),
        (LOG + '{"time": 0.3, "q": [0, 0,', "line 3: must be a JSON object, got "
         "'{\"time\": 0.3, \"q\": [0, 0,'."),
        (LOG + "\n" + LOG, "line 3: must be a JSON object, got ''."),
        (LOG + "7\n", "line 3: must be a JSON object, got '7'."),
        (LOG + '{"time": 0.3, "q": [0, 0, 1]}\n', "line 3, column q.w: is missing."),
        (LOG + '{"time": 0.3, "q": null}\n', "line 3, column q.w: is missing."),
        (LOG + '{"time": "now", "q": [0, 0, 0, 1]}\n', "line 3, column time: must be a "
         "finite number, got \"'now'\"."),
        (LOG + '{"time": 0.3, "q": [0, NaN, 0, 1]}\n', "line 3, column q.y: must be a "
         "finite number, got 'nan'."),
        (LOG + '{"time": 0.3, "q": [0, true, 0, 1]}\n', "line 3, column q.y: must be a "
         "finite number, got 'True'."),
        (LOG + '{"time": 0.3, "q": [0, 0, 0, 2]}\n', "line 3, columns q.w,q.x,q.y,q.z: "
         "length must lie within 1 % of 1, got 2."),
        (LOG + LOG, "line 3, column time: times must rise, got 0.1 after 0.2."),
        ('{"time": 1, "x": 0, "y": 0}\n', "line 1, column qw: is missing; the header "
         "is 'time,x,y'."),
        ('{"t": 1, "pose": {"time": 1, "q": [0, 0, 0, 1]}}\n', "line 1, columns t and "
         "pose.time: either could be meant; choose by the option columns."),
        ('{"t": 1, "q": [0, 0, 0, 1], "p": {"q": [0, 0, 0, 1]}}\n', "line 1, columns "
         "q.w and p.q.w: either could be meant; choose by the option columns."),
        ("{}\n", "line 1, column t_s: is missing; the header is ''."),
        ('{"a":' * 100_000, "line 1: must be a JSON object, got '" + '{"a":' * 11
         + '{"...\'.'),
    ],
)  # fmt: skip
def test_reader_says_what_is_wrong_and_where(file, content, message):
    separator = ", " if message.startswith("line") else ": "
    assert message_of(file(content)) == "me.csv" + separator + message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": ("time", "qw", "qx", "qy")}, "me.csv, option columns, column qz: "
         "is missing; the header is 'time,qw,qx,qy'."),
        ({"columns": ("time", "qw", "qx", "qy", "qz", "-")}, "me.csv, line 2: must "
         "have 6 fields like the header, got 5."),
        ({"columns": ("t", "qw", "qx", "qy", "qz", "t")}, "me.csv, option columns, "
         "column t: appears twice; the header is 't,qw,qx,qy,qz,t'."),
        ({"columns": ("t", "-", "yaw", "pitch", "\u2028roll\n"), "time_unit": "s"},
         "fine"),
        ({"axes": "Unity"}, "axes must be one of openxr, unity, got 'Unity'. Did you "
         "mean 'unity'?"),
        ({"time_unit": "min"}, "time_unit must be one of s, ms, us, ns, got 'min'."),
    ],
)  # fmt: skip
def test_options_are_checked(file, options, message):
    if message == "fine":
        assert Trace.read(file(GOOD), **options).duration_s == 0.2
    else:
        assert message_of(file(GOOD), **options) == message


def test_truncated_files_are_refused_wherever_they_end(file):
    text = GOOD.replace("0.6", "0.600000").rstrip()
    for end in range(len(GOOD) - 12):
        content = text[:end]
        # Whole rows, and a last digit less within 1 %, cannot be told from the end.
        if not re.search(r"(?m)^[\d.]+(,[\d.]+){4}$|^$", content.rsplit("\n", 1)[-1]):
            message_of(file(content))


# --- whatever the bytes ---

VALID = [
    SAMPLE,
    table(NAMES, [T_S, WXYZ], ";", comma=True),
    table(["time_ms", "x", "y", "z", "w"], [1e3 * T_S, WXYZ[:, [1, 2, 3, 0]]], "\t"),
    table(["Time", "Pitch", "Yaw", "Roll"], [T_S, 50 * WXYZ[:, 1:]], " ", comma=True),
    "# by hand\n" + re.sub(r"\d\.\d+", lambda n: f'"{n[0].replace(".", ",")}"', SAMPLE),
    plain_log(by_name),
    plain_log(lambda w, *xyz: {"pose": {"orientation": [*xyz, w]}, "note": None}),
    "[" + plain_log(by_name).strip().replace("\n", ",\n") + "]",
]
SNIPPETS = [*',;\t\n\r"#{}[]: .-+eE_0179', "\u2028", "\x00", "nan", "1e308", "9" * 400]
SNIPPETS += ["qw", "t_s", "time", "null", "\x1c", "\xa0", "½", "-0.0", "true", "\ufeff"]
edits = st.lists(
    st.tuples(
        st.integers(0, 500), st.integers(0, 8), st.sampled_from(["", "", *SNIPPETS])
    ),
    max_size=4,
)
words = [*NAMES, "time", "time_ns", "pitch", "yaw", "roll", "-", "", "x", "a\nb", "q"]
options = st.fixed_dictionaries(
    {},
    optional={
        "columns": st.one_of(
            st.lists(st.sampled_from(words), max_size=7),
            st.permutations(NAMES),
            st.permutations(["time", "yaw", "pitch", "roll"]),
        ),
        "time_unit": st.sampled_from(["s", "ms", "us", "ns", "h"]),
        "axes": st.sampled_from(["openxr", "unity", "blender"]),
        "skip_damaged": st.booleans(),
        "skip_held": st.booleans(),
    },
)


@settings(max_examples=150)
@given(st.sampled_from(VALID), edits, st.booleans(), options)
def test_edited_files_give_a_trace_or_one_clear_line(
    tmp_path_factory, text, edits, headless, options
):
    for start, length, snippet in edits:
        start = start % (len(text) + 1)
        text = text[:start] + snippet + text[start + length :]
    if headless:
        text = text.partition("\n")[2]
    assert_trace_or_clear(tmp_path_factory, text.encode(), options)


@settings(max_examples=100)
@given(st.binary(max_size=80), st.sampled_from(VALID), st.integers(0, 500), options)
def test_any_bytes_give_a_trace_or_one_clear_line(
    tmp_path_factory, content, text, keep, options
):
    content = text[:keep].encode() + content if keep < 250 else content
    assert_trace_or_clear(tmp_path_factory, content, options)


def assert_trace_or_clear(tmp_path_factory, content, options):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    trace, message = None, "any.csv: is fine"
    try:
        trace = Trace.read(path, **options)
    except ValueError as error:
        message = str(error)
    assert message.startswith(("any.csv", "time_unit must", "axes must"))
    assert len(message.splitlines()) == 1
    if trace is not None:
        lengths = np.linalg.norm(trace.world_from_head, axis=1)
        np.testing.assert_allclose(lengths, 1.0, rtol=1e-15)
        assert np.all(np.diff(trace.t_s) > 0)
        assert np.all(np.diff(trace.frame_numbers) > 0)
        assert len(trace.parts()) >= 1


# --- what other programs write ---


def webxr(w, x, y, z):
    """Pose of a viewer as WebXR has it: points have a fourth number, and matrices."""
    point = by_name(1.0, 0.01, 1.6, -0.2)
    return {
        "transform": {
            "position": point,
            "orientation": by_name(w, x, y, z),
            "matrix": {str(i): 0.0 for i in range(16)},
        },
        "linearVelocity": by_name(0.0, 0.1, 0.2, 0.3),
        "emulatedPosition": False,
    }


@pytest.mark.parametrize(
    "orientation",
    [
        webxr,
        lambda *wxyz: {"position": by_name(1, 0, 0, 0), "orientation": by_name(*wxyz)},
        lambda *wxyz: {"p": by_name(1, 0, 0, 0), "q": by_name(*wxyz)},
    ],
)
def test_a_position_with_a_fourth_number_is_no_orientation(file, orientation):
    assert_is_the_sample(Trace.read(file(plain_log(orientation))))
    names = [*NAMES, "position.x", "position.y", "position.z", "position.w"]
    points = np.tile([0.0, 0.0, 0.0, 1.0], (len(T_S), 1))
    assert_is_the_sample(Trace.read(file(table(names, [T_S, WXYZ, points]))))
    alone = plain_log(lambda *_: {"position": by_name(1, 0, 0, 0)})
    assert "line 1, column qw: is missing" in message_of(file(alone))


@pytest.mark.parametrize("indent", [None, 0, 2])
@pytest.mark.parametrize("wrap", [lambda s: s, lambda s: {"device": "x", "poses": s}])
def test_an_array_of_samples_is_read(file, indent, wrap):
    samples = [json.loads(line) for line in plain_log(webxr).splitlines()]
    text = json.dumps(wrap(samples), indent=indent)
    assert_is_the_sample(Trace.read(file(text, "me.json")))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[", "has no samples."),
        ("[]", "has no samples."),
        ("[[0.0, 1, 0, 0, 0], [0.1, 1, 0, 0, 0]]", "sample 1: must be a JSON object, "
         "got '[0.0, 1, 0, 0, 0]'."),
        ('[{"time": 0, "q": [0, 0, 0, 1]}, {"time": 0.1, "q": [0, 0,', "sample 2: must "
         "be a JSON object, got '{\"time\": 0.1, \"q\": [0, 0,'."),
        ('[{"time": 0.1, "q": [0, 0, 0, 1]}, {"time": 0.1, "q": [0, 0, 0, 1]}]',
         "sample 2, column time: times must rise, got 0.1 after 0.1 (a duplicate)."),
        ('[{"t": 0, "matrix": [1, 0, 0, 0, 1, 0, 0, 0, 1]}]', "sample 1, column qw: is "
         "missing; the header is 't,matrix.0,matrix.1,matrix.2,matrix.3,matrix.4,"
         "matrix.5,m...'; matrices are not read: write unit quaternions."),
        ("t,m00,m01,m02,m10,m11,m12,m20,m21,m22\n", "line 1, column qw: is missing; "
         "the header is 't,m00,m01,m02,m10,m11,m12,m20,m21,m22'; matrices are not "
         "read: write unit quaternions."),
    ],
)  # fmt: skip
def test_arrays_and_matrices_that_cannot_be_read_are_told(file, content, message):
    separator = ": " if message.startswith("has") else ", "
    assert message_of(file(content)) == "me.csv" + separator + message


@pytest.mark.parametrize("unit", ["rad", "radians"])
def test_angles_in_radians_are_told_by_their_names(file, rng, unit):
    angles = euler_deg(rng)
    t_s = np.arange(50) / 90
    in_deg = Trace.read(file(table(["time", *angles], [t_s, *angles.values()])))
    names = ["time", *(f"{name}_{unit}" for name in angles)]
    radians = [np.radians(angle) for angle in angles.values()]
    in_rad = Trace.read(file(table(names, [t_s, *radians])))
    np.testing.assert_allclose(
        in_rad.world_from_head, in_deg.world_from_head, atol=1e-14
    )
    assert in_rad.notes == in_deg.notes == ()
    # Small angles without a unit could be either, so it is said what they are taken as.
    bare = Trace.read(file(table(["time", *angles], [t_s, *radians])))
    assert bare.notes[0].startswith("me.csv: pitch, yaw, roll are taken as degrees")


# --- damaged rows ---

MANY = [f"{k / 90:.6f},1,0,0,{k / 1e4}" for k in range(100)]
SAMPLES = [json.dumps({"time": k / 90, "q": [0, 0, k / 1e4, 1]}) for k in range(100)]


@pytest.mark.parametrize(
    ("at", "rows", "kind"),
    [
        (50, [MANY[49]], "times that do not rise (1)"),
        (50, [MANY[48], MANY[49]], "times that do not rise (2)"),
        (50, ["1e6,1,0,0,0"], "times that do not rise (1)"),
        (0, ["1e6,1,0,0,0", "1e7,1,0,0,0"], "times that do not rise (2)"),
        (50, ["0.01,1,0,0,0", "1e6,1,0,0,0"], "times that do not rise (2)"),
        (100, ["0.5,1,0,0,0"], "times that do not rise (1)"),
        (100, ["1.11111,1,0"], "cut or of other lengths than the header (1)"),
        (30, ["# paused", "", "  # again"], "comments or blank lines (3)"),
        (30, ["x,1,0,0,0"], "not numbers (1)"),
        (30, ["0.3301,1,nan,0,0"], "not numbers (1)"),
        (30, ["0.3301,0,0,0,0"], "lengths other than 1 (1)"),
        (30, ["# paused", "0.3301,0", "0.32,1,0,0,0"], "comments or blank lines (1), "
         "cut or of other lengths than the header (1), times that do not rise (1)"),
    ],
)  # fmt: skip
def test_damaged_rows_of_a_table_are_left_out_and_counted(file, at, rows, kind):
    header = "t_s,qw,qx,qy,qz"
    whole = Trace.read(file("\n".join([header, *MANY])))
    damaged = file("\n".join([header, *MANY[:at], *rows, *MANY[at:]]))
    assert "line" in message_of(damaged)
    trace = Trace.read(damaged, skip_damaged=True)
    np.testing.assert_array_equal(trace.t_s, whole.t_s)
    np.testing.assert_array_equal(trace.world_from_head, whole.world_from_head)
    (note,) = trace.notes
    damaged = sum("," in row for row in rows)
    assert f"left out as damaged, of {100 + damaged} rows: {kind}" in note
    assert whole.notes == Trace.read(file("\n".join([header, *MANY]))).notes == ()


@pytest.mark.parametrize(
    ("at", "row"),
    [
        (99, SAMPLES[99][:20]),
        (40, SAMPLES[40][:20]),
        (40, '{"time": 0.4}'),
        (0, '{"time": 0, "q": null}'),
        (0, '{"device": "x"}'),
    ],
)
@pytest.mark.parametrize("is_array", [False, True])
def test_damaged_samples_are_left_out_and_counted(file, at, row, is_array):
    rows = [*SAMPLES[:at], row, *SAMPLES[at + 1 :]]
    end = "" if at == 99 else "]"
    text = "[\n" + ",\n".join(rows) + end if is_array else "\n".join(rows)
    word = "sample" if is_array else "line"
    assert f"{word} {at + 1}" in message_of(file(text))
    trace = Trace.read(file(text), skip_damaged=True)
    np.testing.assert_allclose(trace.t_s, np.delete(np.arange(100) / 90, at))
    assert "cut or of other lengths than the header (1)" in trace.notes[0]


def test_a_time_far_too_late_is_named_and_not_the_good_one_behind_it(file):
    rows = [*MANY[:50], "1e6,1,0,0,0", *MANY[50:]]
    message = message_of(file("\n".join(["t_s,qw,qx,qy,qz", *rows])))
    at = "me.csv, line 52, column t_s"
    assert message == f"{at}: times must rise, got 1e6 before 0.555556."


def test_more_than_some_damage_is_another_format(file):
    # 120 Hz in hundredths of a second: every sixth time is there twice.
    rows = [f"{round(k / 120, 2)},1,0,0,{k / 1e4}" for k in range(120)]
    path = file("\n".join(["t_s,qw,qx,qy,qz", *rows]))
    assert "(a duplicate)" in message_of(path)
    message = message_of(path, skip_damaged=True)
    assert message.startswith("me.csv: at most 10% of its rows may be damaged")
    assert re.search(r"got \d+ of 120: times that do not rise \(\d+\)", message)


def test_a_unit_that_steps_tell_is_told(file):
    text = table(["time", *NAMES[1:]], [1e3 * T_S, WXYZ])
    assert Trace.read(file(text)).notes == ("me.csv: times are taken as ms.",)
    assert Trace.read(file(text), time_unit="ms").notes == ()
