"""Positions of recorded heads: which columns hold them; they stay with their rows."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hmdjit.head_motion import Trace

ROWS = 40
T_S = np.arange(ROWS) / 50
TURNS = Rotation.from_rotvec(0.01 * np.arange(ROWS)[:, None] * [1.0, 2.0, -1.0])
WXYZ = TURNS.as_quat(scalar_first=True)
PLACE_M = np.column_stack([np.linspace(0, 0.4, ROWS), 1.6 + T_S**2, -np.sin(T_S)])
POSES = np.hstack([WXYZ, PLACE_M])


def table(header, *columns):
    rows = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    return "\n".join([header, *rows]) + "\n"


def assert_is_the_sample(trace, place_m=PLACE_M):
    np.testing.assert_allclose(trace.position_m, place_m, rtol=1e-15, atol=1e-15)
    assert trace.poses.shape == (ROWS, 7)
    np.testing.assert_array_equal(trace.poses[:, :4], trace.world_from_head)


@pytest.mark.parametrize(
    ("names", "per_m"),
    [
        ("t_s,x,y,z,qw,qx,qy,qz", 1),
        ("t_s,tx,ty,tz,qw,qx,qy,qz", 1),
        ("time [s],Pos X,Pos Y,Pos Z,Quat W,Quat X,Quat Y,Quat Z", 1),
        ("t_s,HMD.posX,HMD.posY,HMD.posZ,HMD.qW,HMD.qX,HMD.qY,HMD.qZ", 1),
        ("t_s,x_m,y_m,z_m,qw,qx,qy,qz", 1),
        ("t_s,px_cm,py_cm,pz_cm,qw,qx,qy,qz", 100),
        ("t_s,position x (mm),position y (mm),position z (mm),qw,qx,qy,qz", 1000),
        ("t_s,location_x_metres,location_y_metres,location_z_metres,qw,qx,qy,qz", 1),
    ],
)
def test_names_of_positions_and_their_units_are_understood(file, names, per_m):
    trace = Trace.read(file(table(names, T_S, per_m * PLACE_M, WXYZ)))
    assert_is_the_sample(trace)
    *assumed, moved = trace.notes
    assert moved == "me.csv: has positions: the eye moves within 0.4 x 0.608 x 0.703 m."
    says_unit = any(word in names for word in ("_m", "mm", "cm", "metres"))
    assert bool(assumed) != says_unit
    if assumed:
        x, y, z = names.split(",")[1:4]
        assert assumed == [
            f"me.csv: {x}, {y}, {z} are taken as the eye's position in m."
        ]


def test_angles_have_positions_too(file):
    angles = np.tile([10.0, -20.0, 5.0], (ROWS, 1))
    names = "t_s,head_x,head_y,head_z,head_pitch,head_yaw,head_roll"
    trace = Trace.read(file(table(names, T_S, PLACE_M, angles)))
    assert_is_the_sample(trace)


@pytest.mark.parametrize(
    "names",
    [
        "t_s,left_x,left_y,left_z,qw,qx,qy,qz",  # of a controller
        "t_s,gaze_x,gaze_y,gaze_z,hmd_qw,hmd_qx,hmd_qy,hmd_qz",
        "t_s,velocity_x,velocity_y,velocity_z,qw,qx,qy,qz",
        "t_s,x,y,depth,qw,qx,qy,qz",
        "t_s,x_mm,y_m,z_m,qw,qx,qy,qz",
        "t_s,x_px,y_px,z_px,qw,qx,qy,qz",
    ],
)
def test_what_is_no_position_of_the_head_is_none(file, names):
    trace = Trace.read(file(table(names, T_S, PLACE_M, WXYZ)))
    assert trace.position_m is None
    np.testing.assert_array_equal(trace.poses, trace.world_from_head)
    assert trace.notes == ()


def test_two_positions_are_refused_unless_columns_choose(file):
    names = "t_s,x,y,z,qw,qx,qy,qz,pos_x,pos_y,pos_z"
    path = file(table(names, T_S, PLACE_M, WXYZ, 9 * PLACE_M))
    with pytest.raises(ValueError, match="columns x and pos_x: either could be meant"):
        Trace.read(path)
    columns = names.split(",")
    assert_is_the_sample(Trace.read(path, columns=[*columns[:8], "-", "-", "-"]))
    none = Trace.read(path, columns=["t_s", "-", "-", "-", *columns[4:8], *"---"])
    assert none.position_m is None


@pytest.mark.parametrize(
    "place", [list, lambda xyz: dict(x=xyz[0], y=xyz[1], z=xyz[2], w=1.0)]
)
def test_logs_hold_positions(file, place):
    samples = [
        {"t_s": t, "pose": {"position": place(xyz), "orientation": [*q[1:], q[0]]}}
        for t, xyz, q in zip(T_S, PLACE_M.tolist(), WXYZ.tolist(), strict=True)
    ]
    text = "\n".join(map(json.dumps, samples))
    assert_is_the_sample(Trace.read(file(text, "me.jsonl")))


def test_axes_act_on_positions_as_on_rotations(file):
    """Seen in a mirror, z forward: the eye stands where the head looks."""
    trace = Trace.read(
        file(table("t_s,qw,qx,qy,qz,x_m,y_m,z_m", T_S, POSES)), axes="unity"
    )
    mirror = np.diag([1.0, 1.0, -1.0])
    assert_is_the_sample(trace, PLACE_M @ mirror)
    turns = Rotation.from_matrix(mirror @ TURNS.as_matrix() @ mirror)
    ahead = Rotation.from_quat(trace.world_from_head, scalar_first=True).apply(
        [0, 0, -1]
    )
    np.testing.assert_allclose(ahead, turns.apply([0, 0, -1]), atol=1e-14)
    # In the file's own axes the head looks along its +z.
    np.testing.assert_allclose(ahead @ mirror, TURNS.apply([0, 0, 1]), atol=1e-14)


def test_what_is_written_is_read(tmp_path):
    trace, path = Trace(T_S, POSES), tmp_path / "me.csv"
    trace.write(path)
    assert path.read_text().startswith("t_s,qw,qx,qy,qz,x_m,y_m,z_m\n")
    again = Trace.read(path)
    np.testing.assert_array_equal(again.poses, trace.poses)


def test_positions_stay_with_their_rows():
    t_s = np.append(T_S, T_S[-1] + 1 + T_S)  # a gap
    trace = Trace(t_s, np.vstack([POSES, POSES]))
    for part in trace.parts():
        np.testing.assert_array_equal(part.position_m, PLACE_M)
    double = trace.parts()[0].resample(100.0)
    assert double.position_m is not None
    np.testing.assert_allclose(double.position_m[::2], PLACE_M, atol=1e-14)
    between = (PLACE_M[1:] + PLACE_M[:-1]) / 2  # straight from row to row
    np.testing.assert_allclose(double.position_m[1::2], between, atol=1e-14)
    windows = trace.windows(ROWS)
    assert windows.shape == (2, ROWS, 7)
    np.testing.assert_array_equal(windows[1, :, 4:], PLACE_M)


def test_rows_that_move_are_not_held():
    rest = np.hstack([np.tile([1.0, 0, 0, 0], (ROWS, 1)), PLACE_M])
    assert len(Trace(T_S, rest).without_held().t_s) == ROWS
    held = np.repeat(rest[::2], 2, axis=0)
    kept = Trace(T_S, held).without_held()
    np.testing.assert_array_equal(kept.position_m, PLACE_M[::2])


def test_damaged_positions_are_damaged_rows(file):
    lines = table("t_s,qw,qx,qy,qz,x_m,y_m,z_m", T_S, POSES).splitlines()
    lines[20] = lines[20].rpartition(",")[0] + ",nan"
    path = file("\n".join(lines))
    with pytest.raises(ValueError, match=r"line 21, column z_m: must be a finite"):
        Trace.read(path)
    trace = Trace.read(path, skip_damaged=True)
    np.testing.assert_array_equal(trace.position_m, np.delete(PLACE_M, 19, axis=0))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_the_constructor_checks_positions(value):
    poses = POSES.copy()
    poses[3, 5] = value
    with pytest.raises(ValueError, match=r"trace, row 4, column y_m: must be a number"):
        Trace(T_S, poses)
    with pytest.raises(ValueError, match=r"\(rows, 4\), or \(rows, 7\) with positions"):
        Trace(T_S, POSES[:, :6])
