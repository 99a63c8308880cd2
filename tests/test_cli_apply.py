import csv
import errno
import functools
import re
import struct
import zlib

import numpy as np
import PIL.Image
import pytest
import small
from scipy.spatial.transform import Rotation, Slerp

import hmdjit as hj
from hmdjit.cli import main as cli
from hmdjit.cli.frame_files import FrameFiles
from hmdjit.cli.frame_poses import aligned
from hmdjit.simulation import pose_fit
from hmdjit.simulation.pose_fit import INVERTED, WITHOUT, PoseFit

WIDTH, HEIGHT, COUNT, FOV, RATE = small.WIDTH, small.HEIGHT, small.FRAMES, 6.0, 72.0
CAMERA = hj.Camera(WIDTH, HEIGHT, FOV, RATE)
CONJUGATE, MIRROR = np.array([1, -1, -1, -1]), np.array([1, -1, -1, 1])


def poses_of(seed=0, count=COUNT):
    """A head that looks to the left and up, and turns by 0.6 px per frame and axis."""
    turns = np.random.default_rng(seed).normal(size=(count, 3)) * 0.6 / CAMERA.focal_px
    path = Rotation.from_rotvec(np.cumsum(turns, axis=0))
    start = Rotation.from_euler("YX", [60, 20], degrees=True)
    return (start * path).as_quat(scalar_first=True)


@functools.cache
def clip():
    """Waves in all directions of the world, some 8 px long, seen with these poses."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = np.stack([x - WIDTH / 2, HEIGHT / 2 - y, np.full_like(x, -CAMERA.focal_px)])
    rays = np.moveaxis(rays / np.linalg.norm(rays, axis=0), 0, -1)
    heads = Rotation.from_quat(poses_of(), scalar_first=True).as_matrix()
    world = np.einsum("fij,hwj->fhwi", heads, rays)
    waves = rng.normal(size=(3, 3)) * CAMERA.focal_px / 2
    return 0.5 + 0.4 * np.sin(world @ waves.T)


def codes():
    return np.round(255 * clip()).astype(np.uint8)


def frames_in(folder, name="frame_{:03}.png", pictures=None, **options):
    folder.mkdir()
    for k, picture in enumerate(codes() if pictures is None else pictures):
        PIL.Image.fromarray(picture).save(folder / name.format(k), **options)
    return folder


def log(path, poses=None, t_s=None):
    poses = poses_of() if poses is None else poses
    t_s = np.arange(len(poses)) / RATE if t_s is None else t_s
    table = np.column_stack([t_s, poses])
    np.savetxt(path, table, "%.9f", ",", header="t_s,qw,qx,qy,qz", comments="")
    return path


def png_of(side_px):
    """A grey PNG of which most is missing."""
    sizes = struct.pack(">IIBBBBB", side_px, side_px, 8, 0, 0, 0, 0)
    chunks = [(b"IHDR", sizes), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")]
    chunk = lambda name, data: (
        struct.pack(">I", len(data))
        + name
        + data
        + struct.pack(">I", zlib.crc32(name + data))
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*item) for item in chunks)


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """Run `hmdjit apply` in a folder of its own; its words, or error, on one line."""
    monkeypatch.chdir(tmp_path)

    def apply(*arguments, fails=False):
        options = () if "--fov" in arguments else ("--fov", FOV)
        code = cli.run(["apply", *map(str, (*arguments, *options)), "--no-report"])
        printed = capsys.readouterr()
        assert code == (2 if fails else 0), printed.err
        assert printed.err.count("\n") == fails
        return printed.err if fails else " ".join(printed.out.split())

    return apply


@pytest.fixture
def frames(tmp_path):
    return frames_in(tmp_path / "frames")


@pytest.fixture
def poses(tmp_path):
    return log(tmp_path / "poses.csv")


def shown(folder):
    files = sorted(folder.glob("*.png"))
    return np.stack([np.asarray(PIL.Image.open(file)) for file in files])


def test_it_shows_what_the_api_shows(run, frames, poses, tmp_path):
    printed = run("head_movement", frames, poses, "--out", "shown")
    assert "Warning" not in printed
    assert (
        "Camera: 24 x 18 px, 6 deg wide (as given), 72.00 Hz (of the poses)" in printed
    )
    expected = hj.apply(
        hj.techniques.HeadMovement(),
        CAMERA,
        codes(),
        hj.Trace.read(poses).world_from_head,
    )
    # Half a code value of rounding, and 1e-5 where the value lies on the border.
    found = shown(tmp_path / "shown")
    assert np.abs(found - 255 * np.asarray(expected)).max() < 0.5 + 255e-5

    exact, rough = hj.metrics.mtcd(expected), hj.metrics.mtcd(found / 255)
    before = hj.metrics.mtcd(codes() / 255.0)
    assert abs(exact - rough) > 1e-3
    row = f"head_movement {exact:.3f} {exact / before:.3f} {rough:.3f}"
    assert f"{row} {rough / before:.3f}" in printed
    assert f"frames, before {before:.3f} 1.000 {before:.3f} 1.000" in printed


# --- poses that do not fit ---


@pytest.mark.parametrize(
    ("written", "options", "warning"),
    [
        (poses_of() * CONJUGATE, (), "inverted quaternions"),
        (poses_of() * MIRROR, (), "the other axes: --axes unity"),
        (poses_of() * MIRROR, ("--axes", "unity"), None),
        (poses_of(), ("--axes", "unity"), "the other axes: --axes openxr"),
        (
            np.roll(poses_of(), -1, axis=1),
            ("--columns", "t", "qx", "qy", "qz", "qw"),
            None,
        ),
        (poses_of(), ("--fov", "110"), "--fov: a field of view of about"),
    ],
    ids=["inverted", "mirrored", "unity", "openxr", "columns", "fov"],
)
def test_poses_that_do_not_fit_are_told(
    run, frames, tmp_path, written, options, warning
):
    poses = log(tmp_path / "poses.csv", written)
    printed = run("none", frames, poses, *options)
    errors = re.search(
        r"([\d.]+) code values without reprojection, ([\d.]+) reprojected by these "
        r"poses, ([\d.]+) by inverted ones",
        printed,
    )
    assert errors is not None, printed
    without, given, inverted = map(float, errors.groups())
    assert (given < 0.5 * min(without, inverted)) == (warning is None)
    assert ("Warning" in printed) == (warning is not None)
    assert warning is None or warning in printed.partition("Warning")[2]


def fit(camera=CAMERA, poses=None, pictures=None):
    found = PoseFit(camera, poses_of() if poses is None else poses)
    for picture in clip() if pictures is None else pictures:
        found.add(picture)
    return found


def test_reprojection_by_the_right_poses_leaves_little():
    found = fit()
    assert found.error() < 0.5 * found.error(WITHOUT) < 0.5 * found.error(INVERTED)
    assert found.tells
    assert found.likely_causes() is None


@pytest.mark.parametrize(
    ("poses", "causes"),
    [
        (np.roll(poses_of(), 1, axis=0), ["one frame late"]),
        (np.roll(poses_of(), -1, axis=0), ["one frame early"]),
        (np.roll(poses_of(), -1, axis=1), ["xyzw read as wxyz"]),
        (np.roll(poses_of(), 1, axis=1), ["wxyz read as xyzw"]),
        (poses_of(seed=1), []),
    ],
    ids=["late", "early", "xyzw", "wxyz", "another clip's"],
)
def test_wrong_readings_of_poses_are_told(poses, causes):
    assert (fit(poses=poses).likely_causes() or [])[:1] == causes


@pytest.mark.parametrize("scale", [0.25, 0.6, 1.6, 4.0])
def test_a_field_of_view_that_is_far_off_is_told(scale):
    tangent = np.tan(np.radians(FOV / 2)) * scale
    wrong = hj.Camera(WIDTH, HEIGHT, np.degrees(2 * np.arctan(tangent)), RATE)
    cause = (fit(wrong).likely_causes() or [""])[0]
    assert float(re.findall(r"[\d.]+", cause)[0]) == pytest.approx(FOV, rel=0.1)


def test_still_heads_and_uniform_pictures_do_not_tell():
    assert not fit(poses=np.tile(poses_of()[:1], (COUNT, 1))).tells
    assert not fit(pictures=np.full((COUNT, HEIGHT, WIDTH, 3), 0.4)).tells


def test_noise_without_motion_does_not_pass_for_a_fit(rng):
    # Blur brings any two noisy pictures closer.
    pictures = rng.random((COUNT, 64, 64, 3))
    assert fit(hj.Camera(64, 64, FOV, RATE), pictures=pictures).likely_causes() == []


def test_long_clips_are_sampled(monkeypatch):
    monkeypatch.setattr(pose_fit, "_MOST_PAIRS", 3)
    found = fit()
    assert found._pairs == 3
    assert found.likely_causes() is None


# --- which frames there are ---


def test_frames_named_by_times_are_in_their_order(run, tmp_path):
    times = 1305031102.675304 + np.arange(COUNT) / 20  # 1305031103 has fractions too
    names = [f"{time:.6f}" for time in times]
    pictures = codes()
    folder = frames_in(tmp_path / "frames", pictures=[])
    for name, picture in zip(names, pictures, strict=True):
        PIL.Image.fromarray(picture).save(folder / f"{name.rstrip('0')}.png")
    printed = run("none", folder)
    before = hj.metrics.mtcd(pictures / 255.0)
    assert f"frames, before {before:.3f}" in printed
    assert f"order of their numbers, {names[0]}.png to {names[-1]}.png" in printed


def test_counts_behind_a_number_and_a_point_are_no_fractions(run, tmp_path, frames):
    folder = frames_in(tmp_path / "shots", pictures=[])
    for k, picture in enumerate(codes(), 4):  # 4 to 11, and 1 is no part of it
        PIL.Image.fromarray(picture).save(folder / f"shot1.{k}.png")
    printed = run("none", folder)
    assert "order of their numbers, shot1.4.png to shot1.11.png" in printed
    (row,) = re.findall(r"frames, before [\d. ]+", run("none", frames))
    assert row in printed


def test_other_files_are_no_frames(run, frames):
    (frames / "._frame_001.png").write_bytes(b"\0\5\26\7 AppleDouble")
    (frames / "frame_notes_9.txt").write_text("no picture")
    PIL.Image.fromarray(codes()[0]).save(frames / "cover.png")
    assert "8 frames in the order of their numbers, frame_000.png" in run(
        "none", frames
    )


def test_missing_numbers_are_told(run, frames):
    assert "missing" not in run("none", frames)
    for k in (3, 5):
        (frames / f"frame_{k:03}.png").unlink()
    assert "Warning: missing frames: 3, 5." in run("none", frames)


@pytest.mark.parametrize("alpha", [0, 128])
def test_frames_are_opaque_unless_asked_otherwise(run, frames, tmp_path, alpha):
    layers = np.concatenate([codes(), np.full_like(codes()[..., :1], alpha)], axis=-1)
    folder = frames_in(tmp_path / "rgba", pictures=layers)
    opaque, junk = run("none", frames), run("none", folder)
    (row,) = re.findall(r"frames, before [\d. ]+", opaque)
    assert row in junk
    assert "Frames have an alpha channel: ignored" in junk
    on_black = run("none", folder, "--alpha")
    assert ("MTCD 0 before: no flicker to remove." in on_black) == (alpha == 0)
    assert row not in on_black


def test_jpeg_is_read_with_a_word_about_it(run, frames, tmp_path):
    assert "JPEG" not in run("none", frames)
    folder = frames_in(tmp_path / "jpeg", "frame_{}.JPG", quality=90)
    assert "Warning: JPEG's compression errors" in run("none", folder, "--out", "shown")
    assert len(shown(tmp_path / "shown")) == COUNT


# --- what is written ---


def test_a_second_run_leaves_nothing_of_the_first(run, frames, tmp_path):
    out = tmp_path / "shown"
    run("none", frames, "--out", out)
    (out / "notes.txt").write_text("mine")
    PIL.Image.fromarray(codes()[0]).save(out / "mine.png")
    for k in range(5, COUNT):
        (frames / f"frame_{k:03}.png").unlink()
    run("freeze", frames, "--out", out)
    names = sorted(file.name for file in out.iterdir())
    assert names == [*(f"frame_{k:03}.png" for k in range(5)), "mine.png", "notes.txt"]


def test_other_pictures_beside_displayed_ones_may_be_damaged(run, frames, tmp_path):
    others = frames_in(tmp_path / "shown", pictures=[])
    for side in (10_000, 20_000):  # Pillow warns of one and refuses the other
        (others / f"{side}.png").write_bytes(png_of(side))
    (others / "damaged.png").write_bytes(png_of(1)[:30])
    run("none", frames, "--out", "shown")
    assert len([*others.iterdir()]) == COUNT + 3


def test_pictures_that_apply_has_not_made_stay(run, frames, tmp_path):
    others = frames_in(tmp_path / "others")
    message = run("freeze", frames, "--out", others, fails=True)
    assert "out must not overwrite what apply has not made: " in message
    assert "frame_000.png" in message
    np.testing.assert_array_equal(shown(others), codes())


@pytest.mark.parametrize("option", [(), ("--reference", "shown")])
def test_frames_that_are_read_are_never_former_ones(run, frames, tmp_path, option):
    run("none", frames, "--out", "shown")
    folder = frames if option else "shown"
    both = ("--techniques", "freeze", "--out", "shown")
    message = run("none", folder, *option, *both, fails=True)
    assert "--out must differ from the folder of the frames, got shown" in message
    np.testing.assert_array_equal(shown(tmp_path / "shown"), codes())


@pytest.mark.parametrize("names_file", [False, True])
def test_a_full_disk_leaves_nothing(run, frames, tmp_path, monkeypatch, names_file):
    save, saved = PIL.Image.Image.save, []

    def full(image, path, **options):
        if len(saved) == 3:
            name = [str(path)] * names_file
            raise OSError(errno.ENOSPC, "No space left on device", *name)
        saved.append(path)
        save(image, path, **options)

    monkeypatch.setattr(PIL.Image.Image, "save", full)
    message = run("none", frames, "--out", tmp_path / "shown", fails=True)
    assert message == f"hmdjit: error: {tmp_path / 'shown'}: No space left on device\n"
    assert not (tmp_path / "shown").exists()


def test_several_techniques_share_a_table_and_a_csv(run, frames, poses, tmp_path):
    pictures = np.clip(codes().astype(int) + 3, 0, 255).astype(np.uint8)
    reference = frames_in(tmp_path / "reference", "ssaa_{:02}.png", pictures)
    run(
        *("head_movement", frames, poses, "--techniques", "none", "freeze"),
        *(
            "--reference",
            reference,
            "--warmup",
            2,
            "--csv",
            "table.csv",
            "--out",
            "all",
        ),
    )
    with open(tmp_path / "table.csv", newline="") as file:
        rows = {row.pop("technique"): row for row in csv.DictReader(file)}
    assert list(rows) == ["frames, before", "head_movement", "none", "freeze"]
    before, kim, none, freeze = (
        {name: float(value) for name, value in row.items()} for row in rows.values()
    )
    assert none == before
    assert before["mtcd"] == pytest.approx(float(hj.metrics.mtcd(codes()[2:] / 255.0)))
    error = (codes()[2:] - pictures[2:].astype(float)) ** 2
    assert before["detail_loss"] == pytest.approx(error.mean(), rel=1e-5)
    assert (freeze["mtcd"], freeze["mtcd_ratio"]) == (0, 0)
    assert 0 < kim["mtcd_ratio"] < 1
    np.testing.assert_array_equal(shown(tmp_path / "all" / "none"), codes())
    assert len(shown(tmp_path / "all" / "head_movement")) == COUNT


def test_other_metrics_can_be_asked_for(run, frames, tmp_path):
    reference = frames_in(tmp_path / "reference", "ssaa_{:02}.png", 255 - codes())
    named = ("--metrics", "psnr", "mse", "--csv", "table.csv")
    run("none", frames, "--reference", reference, *named)
    with open(tmp_path / "table.csv", newline="") as file:
        row = next(csv.DictReader(file))
    assert list(row) == ["technique", "psnr", "mse"]
    error = np.mean((2.0 * codes() - 255) ** 2)
    assert float(row["mse"]) == pytest.approx(error, rel=1e-5)
    assert float(row["psnr"]) == pytest.approx(10 * np.log10(255**2 / error), rel=1e-5)
    printed = run("none", frames, *named[:3], fails=True)
    assert "--metrics must have a --reference" in printed
    assert "for psnr, mse" in run("none", frames, *named[:3], fails=True)


def test_a_folder_has_an_mtcd_without_poses(run, frames, tmp_path):
    before = set(tmp_path.rglob("*"))
    assert f"{hj.metrics.mtcd(codes() / 255.0):.3f}" in run("none", frames)
    assert set(tmp_path.rglob("*")) == before
    message = run("head_movement", frames, "--out", "shown", fails=True)
    assert "head_movement needs poses, got none" in message
    assert set(tmp_path.rglob("*")) == before


# --- a log that is longer ---


def longer(path, before=5, after=3, rate_hz=RATE, start_s=0.0):
    """Poses of the clip's frames between others, of which frame 0's row is the 6th."""
    poses = np.concatenate([poses_of(2, before), poses_of(), poses_of(3, after)])
    return log(path, poses, start_s + np.arange(len(poses)) / rate_hz)


def test_the_first_row_can_be_named(run, frames, tmp_path):
    poses = longer(tmp_path / "poses.csv")
    message = run("none", frames, poses, fails=True)
    assert re.search("one row per frame: 8 frames .* 16 rows.*--first-row", message)
    assert "Warning" not in run("none", frames, poses, "--first-row", 6)
    assert "Warning" in run("none", frames, poses, "--first-row", 5)
    message = run("none", frames, poses, "--first-row", 0, fails=True)
    assert "--first-row must lie in [1, 16], got 0" in message
    message = run("none", frames, poses, "--first-row", 10, fails=True)
    assert "poses.csv: must reach the last frame's row, 17, has 16" in message


def test_a_damaged_row_moves_no_frame_to_another_pose(run, frames, tmp_path):
    poses = longer(tmp_path / "poses.csv", before=5, after=5)
    lines = poses.read_text().splitlines()
    lines[10] = lines[10].replace(",", ",,", 1)
    poses.write_text("\n".join(lines))
    printed = run("none", frames, poses, "--first-row", 6, "--skip-damaged")
    assert "of 18 rows" in printed
    assert "Poses of the frames' times, " in printed
    assert "Warning" not in printed


def test_a_log_at_another_rate_is_read_by_time(run, frames, tmp_path):
    heads = Rotation.from_quat(poses_of(), scalar_first=True)
    end_s = (COUNT - 1) / RATE
    t_s = np.append(np.arange(0, end_s, 2e-3), end_s)
    found = Slerp(np.arange(COUNT) / RATE, heads)(t_s).as_quat(scalar_first=True)
    t_s = np.concatenate([np.arange(9) * 2e-3, 0.018 + t_s])
    poses = log(tmp_path / "poses.csv", np.concatenate([found[:9], found]), t_s)
    printed = run("none", frames, poses, "--first-row", 10, "--refresh", RATE)
    assert "Warning" not in printed
    assert "72.00 Hz (as given; of the poses 72.00 Hz)" in printed
    message = run(
        "none", frames, poses, "--first-row", 30, "--refresh", RATE, fails=True
    )
    assert "must reach the last frame" in message


def test_poses_of_a_slower_tracker_are_read_by_time(run, frames, tmp_path):
    turns = np.zeros((COUNT, 3))
    turns[:, 1] = np.arange(COUNT) // 2 * 1.2 / CAMERA.focal_px
    poses = log(
        tmp_path / "held.csv", Rotation.from_rotvec(turns).as_quat()[:, [3, 0, 1, 2]]
    )
    assert "poses are held: 4 of 8 rows" in run("none", frames, poses)
    options = ("--skip-held", "--first-row", 1, "--refresh", RATE)
    assert "left out 4 of 8 rows as held" in run("none", frames, poses, *options)


def test_a_lost_frame_keeps_the_others_rows(frames, poses):
    (frames / "frame_003.png").unlink()
    trace = hj.Trace.read(poses)
    found = aligned(trace, FrameFiles.of(frames), None)
    np.testing.assert_array_equal(found.t_s, np.delete(trace.t_s, 3))


def test_frames_named_by_times_find_their_poses(run, tmp_path):
    start_s = 1305031102.0
    poses = longer(tmp_path / "poses.csv", start_s=start_s)
    folder = frames_in(tmp_path / "frames", pictures=[])
    for k, picture in enumerate(codes()):
        # A tenth of a frame late: poses lie between those of two rows.
        time = start_s + (5 + k + 0.1 * (k < COUNT - 1)) / RATE
        PIL.Image.fromarray(picture).save(folder / f"{time:.6f}.png")
    printed = run("none", folder, poses)
    assert "Warning" not in printed
    times = r"1305031102\.0708\d\d to 1305031102\.1666\d\d"
    assert re.search(f"Poses of the frames' times, {times} s in poses.csv", printed)


def test_numbers_that_might_be_times_are_no_times_where_each_has_its_row(
    run, tmp_path, poses
):
    folder = frames_in(tmp_path / "frames", "frame_{}000.png")  # 0 to 7000, as in us
    printed = run("none", folder, poses)
    assert "72.00 Hz (of the poses)" in printed
    assert "Warning" not in printed


def test_frames_in_ns_keep_their_times_from_the_first_row(tmp_path, poses):
    start_ns = 1403636579763555584
    folder = frames_in(tmp_path / "frames", pictures=[])
    for k, picture in enumerate(codes()[:4]):
        time = start_ns + round(2 * k * 1e9 / RATE) + 100 * k
        PIL.Image.fromarray(picture).save(folder / f"{time}.png")
    trace = hj.Trace.read(poses)
    found = aligned(trace, FrameFiles.of(folder), 2)
    np.testing.assert_allclose(found.t_s, trace.t_s[1::2], rtol=0, atol=1e-6)


def test_no_pose_is_made_up_across_a_gap(run, tmp_path):
    t_s = np.arange(30) / RATE + 0.5 * (np.arange(30) > 14)
    poses = log(tmp_path / "poses.csv", poses_of(4, 30), t_s)
    folder = frames_in(tmp_path / "frames", pictures=[])
    for k, picture in enumerate(codes()):
        PIL.Image.fromarray(picture).save(folder / f"{0.1 + k / RATE:.6f}.png")
    message = run("none", folder, poses, fails=True)
    assert "must have poses around each frame, got a gap of 0.5139 s" in message


# --- words ---


def test_help_names_its_arguments(capsys):
    with pytest.raises(SystemExit):
        cli.run(["apply", "--help"])
    printed = capsys.readouterr().out
    assert re.search(r"TECHNIQUE FRAMES_DIR \[POSES.csv\]", printed)
    assert "STR" not in printed
    assert "PATH" not in printed


def test_what_is_assumed_is_told(run, frames, poses):
    printed = run("none", frames, poses, "--refresh", "90")
    assert "90.00 Hz (as given; of the poses 72.00 Hz)" in printed


def test_an_assumed_field_of_view_is_told(frames, poses, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.run(["apply", "none", str(frames), str(poses)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "96 deg wide (assumed: --fov), 72.00 Hz (of the poses)" in printed
    assert "--fov: a field of view of about" in printed


WRONG = [
    (["ssaa2", "frames", "poses.csv"], "4 samples per pixel for ssaa2, got 1"),
    (["taa", "frames", "poses.csv"], "--techniques must be one of"),
    (["none", "frames", "poses.csv", "--out", "frames"], "must differ from the folder"),
    (["none", "frames", "--axes", "unity"], "--axes is of a log of poses: name one"),
    (["none", "frames", "--first-row", "2"], "--first-row is of a log of poses"),
    (["none", "frames", "--csv", "frames"], "--csv must be a file, got the folder"),
    (["none", "frames", "poses.csv", "--fov", "0"], r"--fov must lie in \(0, 180\)"),
    (["none", "frames", "--techniques", "none"], "techniques must all differ"),
    (["none", "frames", "--warmup", "7"], "at least 2 frames after warmup = 7, has 8"),
    (["none", "frames", "--reference", "fewer"], "fewer: has no frame of number 2"),
    (["none", "frames", "--reference", "wide"], "wide.*must be 24 x 18 px"),
    (["none", "broken"], "broken/a_1.png: not a picture that Pillow can read"),
    (["none", "huge"], "huge/a_1.png: too large: Image size"),
    (["none", "frames", "--refresh", "0"], r"--refresh must lie in \(0, inf\)"),
    (["none", "empty"], "at least 2 numbered PNG frames"),
    (["none", "nowhere"], "must be a folder of numbered"),
    (["none", "twice"], "two frames have the number 1: a_01.png and a_1.png"),
    (["none", "mixed"], "must differ in their numbers only, got a_1.png and b_2.png"),
    (["none", "frames", "short.csv"], "8 frames in frames, 5 rows"),
]


@pytest.mark.parametrize(("arguments", "message"), WRONG)
def test_wrong_input_ends_in_one_clear_line(
    run, frames, poses, tmp_path, arguments, message
):
    log(tmp_path / "short.csv", poses_of()[:5])
    frames_in(tmp_path / "fewer", pictures=codes()[:2])
    frames_in(tmp_path / "wide", pictures=np.zeros((COUNT, HEIGHT, 33, 3), np.uint8))
    for folder, names in {
        "empty": [],
        "twice": ["a_1.png", "a_01.png"],
        "mixed": ["a_1.png", "b_2.png"],
    }.items():
        frames_in(tmp_path / folder, pictures=[])
        for name in names:
            PIL.Image.fromarray(codes()[0]).save(tmp_path / folder / name)
    broken = frames_in(tmp_path / "broken", "a_{}.png", codes()[:3])
    huge = frames_in(tmp_path / "huge", "a_{}.png", codes()[:3])
    for folder, picture in {broken: b"", huge: png_of(20_000)}.items():
        (folder / "a_0.png").unlink()
        (folder / "a_1.png").write_bytes(picture)
    before = set(tmp_path.rglob("*"))
    assert re.search(message, run(*arguments, fails=True))
    assert set(tmp_path.rglob("*")) == before
