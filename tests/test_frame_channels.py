"""Channels of frames as files: what is found, read, used and refused."""

import re
from typing import Any

import numpy as np
import PIL.Image
import pytest
import rich.console
from small import CAMERA, FRAMES, HEIGHT, SIZE, WIDTH
from test_rendered import PLANE, Shows, channels

import hmdjit as hj
from hmdjit.cli import main as cli
from hmdjit.cli.frame_channels import ChannelFolders
from hmdjit.cli.frame_files import FrameFiles
from hmdjit.simulation import apply as clips
from hmdjit.techniques import NoAntialiasing

VIEW = WIDTH, HEIGHT
STILL = np.tile([1.0, 0, 0, 0], (FRAMES, 1))


def written(folder, planes, suffix=".npy"):
    """A file per frame."""
    folder.mkdir(parents=True)
    for k, plane in enumerate(planes):
        file = folder / f"a{k + 8}{suffix}"  # a10 comes after a9
        np.save(file, plane) if suffix == ".npy" else PIL.Image.fromarray(plane).save(
            file
        )
    return folder


@pytest.fixture
def frames(tmp_path, rng):
    codes = rng.integers(0, 256, (FRAMES, *SIZE), dtype=np.uint8)
    return written(tmp_path / "frames", codes, ".png")


def displayed(frames, technique, console=None, poses=STILL, **folders):
    """What `apply` streams to a technique."""
    files = FrameFiles.of(frames)
    console = console or rich.console.Console(quiet=True)
    (given,) = ChannelFolders(**folders).of_techniques(
        console, [technique], files, VIEW
    )
    pictures = files.pictures(VIEW)
    return np.stack(list(clips.stream(technique, CAMERA, pictures, poses, **given)))


@pytest.mark.parametrize(
    ("channel", "folder", "suffix", "dtype"),
    [
        ("depth", "depth", ".npy", np.float32),
        ("depth", "depth", ".tif", np.float32),
        ("object_id", "id", ".png", np.uint16),
        ("object_id", "id", ".npy", np.int64),
        ("motion_class", "class", ".png", np.uint8),
        ("albedo", "albedo", ".npy", np.float32),
        ("velocity", "velocity", ".npy", np.float32),
    ],
)
def test_folders_beside_the_frames_are_found(
    frames, rng, channel, folder, suffix, dtype
):
    keyword = "velocity_px" if channel == "velocity" else channel
    given = channels(rng)[keyword].astype(dtype)
    written(frames / folder, given, suffix)
    found = displayed(frames, Shows(channel))
    given = -given if channel == "velocity" else given
    given = given.reshape(FRAMES, HEIGHT, WIDTH, -1)
    np.testing.assert_array_equal(found[..., : given.shape[-1]], given)


def test_depths_in_codes_have_a_scale_and_nothing_at_0(tmp_path, frames, rng):
    codes = rng.integers(1, 2**16, PLANE, dtype=np.uint16)
    codes[0, 0] = 0
    folder = written(tmp_path / "mm", codes, ".png")
    found = displayed(frames, Shows("depth"), depth=folder, depth_scale=1e-3)[..., 0]
    assert np.isinf(found[0, 0]).all()
    np.testing.assert_allclose(found[1:], 1e-3 * codes[1:], rtol=1e-6)


def test_albedo_is_read_as_frames_are(frames, rng):
    codes = rng.integers(0, 256, (FRAMES, *SIZE), dtype=np.uint8)
    written(frames / "albedo", codes, ".png")
    np.testing.assert_allclose(
        255 * displayed(frames, Shows("albedo")), codes, atol=1e-4
    )


def test_velocity_is_derived_from_depth_and_positions(frames, rng):
    given = channels(rng)["depth"].astype(np.float32)
    written(frames / "depth", given)
    poses = np.hstack([STILL, 0.01 * rng.normal(size=(FRAMES, 3))])
    found = displayed(frames, Shows("velocity"), poses=poses)
    black = np.zeros((FRAMES, *SIZE), np.float32)
    expected = hj.apply(Shows("velocity"), CAMERA, black, poses, depth=given)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-5)
    assert np.abs(found[1:]).max() > 1


def test_what_is_used_is_said(frames, rng, capsys):
    written(frames / "depth", channels(rng)["depth"])
    (frames / "id").mkdir()  # empty, and not looked into
    displayed(frames, Shows("depth"), rich.console.Console(width=200))
    assert capsys.readouterr().out == (
        f"depth of {frames / 'depth'}, a8.npy to a15.npy.\n"
        f"{frames / 'id'} is not used: no technique here needs object_id.\n"
    )


def empty(folder):
    for file in folder.iterdir():
        file.unlink()


def replaced(folder, plane, suffix=".npy"):
    """Give one file other content."""
    file = next(folder.glob("a10.*")).with_suffix(suffix)
    np.save(file, plane) if suffix == ".npy" else PIL.Image.fromarray(plane).save(file)


FULL = np.ones((HEIGHT, WIDTH))


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (empty, {}, r"depth: must hold at least 2 numbered files \(.npy, .png, .tif"),
        (lambda folder: (folder / "a10.npy").unlink(), {}, "has no frame of number 10"),
        (lambda folder: replaced(folder, FULL.T), {},
         r"a10.npy: must be 24 x 18 px as the first frame, got shape \(24, 18\)"),
        (lambda folder: replaced(folder, np.stack([FULL, FULL], -1)), {},
         r"a10.npy: depth must have the shape \(1, 18, 24\), got \(1, 18, 24, 2\)"),
        (lambda folder: replaced(folder, 0 * FULL), {}, "a10.npy: depth must be"),
        (lambda folder: replaced(folder, FULL.astype(int)), {},
         r"a10.npy: depths are whole numbers: name their metres .* by --depth-scale"),
        (lambda folder: replaced(folder, FULL), {"depth_scale": 0.1},
         r"a8.npy: depths are metres in floats, which have no --depth-scale"),
        (lambda folder: replaced(folder, FULL), {"depth_scale": 0.0},
         r"depth_scale must lie in \(0, inf\), got 0"),
        (lambda folder: replaced(folder, np.float32(FULL), ".tif"), {}, "two frames"),
        (lambda folder: (folder / "a10.npy").write_bytes(b"no"), {}, "a10.npy: cannot"),
    ],
)  # fmt: skip
def test_folders_that_do_not_fit_are_told_in_one_line(
    frames, rng, change, options, message
):
    change(written(frames / "depth", channels(rng)["depth"]))
    with pytest.raises(ValueError, match=message) as error:
        displayed(frames, Shows("depth"), **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("code", "options", "message"),
    [
        (
            np.uint8(FULL),
            {"depth_scale": 0.1},
            "depths must have 16 bits or more, got 8",
        ),
        (np.uint8(np.ones(SIZE)), {}, "must have one number per pixel, got mode RGB"),
    ],
)
def test_pictures_that_hold_no_depth_are_refused(frames, code, options, message):
    written(frames / "depth", [code] * FRAMES, ".png")
    with pytest.raises(ValueError, match=re.escape(f"a8.png: {message}")):
        displayed(frames, Shows("depth"), **options)


def test_a_file_is_read_once_for_all_techniques(frames, rng, monkeypatch):
    written(frames / "depth", channels(rng)["depth"])
    read, opened = [], np.lib.format.open_memmap
    monkeypatch.setattr(
        np.lib.format, "open_memmap", lambda *a, **k: read.append(1) or opened(*a, **k)
    )
    files, quiet = FrameFiles.of(frames), rich.console.Console(quiet=True)
    techniques = [Shows("depth"), NoAntialiasing(), Shows("depth")]
    given = ChannelFolders().of_techniques(quiet, techniques, files, VIEW)
    assert [list(each) for each in given] == [["depth"], [], ["depth"]]
    for a, b in zip(given[0]["depth"], given[2]["depth"], strict=True):
        assert a is b
    assert len(read) == FRAMES


def test_the_command_says_what_it_does_not_use(frames, rng, tmp_path, capsys):
    written(frames / "id", channels(rng)["object_id"])
    written(tmp_path / "classes", channels(rng)["motion_class"])
    arguments = ["apply", "none", str(frames), "--class", str(tmp_path / "classes")]
    assert cli.run(arguments) == 0
    printed = capsys.readouterr().out
    assert f"{frames / 'id'} is not used: no technique here needs object_id." in printed
    assert "classes is not used: no technique here needs motion_class." in printed


def test_positions_of_a_log_reach_techniques(
    frames, rng, tmp_path, capsys, monkeypatch
):
    place = np.cumsum(0.01 * rng.normal(size=(FRAMES, 3)), axis=0)
    poses = np.hstack([STILL, place])
    hj.Trace(np.arange(FRAMES) / 60, poses).write(tmp_path / "poses.csv")
    seen = []
    stream: Any = clips.stream
    recorded = lambda *a, **k: seen.append(a[3]) or stream(*a, **k)
    monkeypatch.setattr(clips, "stream", recorded)
    out = ["--out", str(tmp_path / "out"), "--fov", "1.5"]
    assert (
        cli.run(["apply", "none", str(frames), str(tmp_path / "poses.csv"), *out]) == 0
    )
    np.testing.assert_allclose(seen[0], poses, atol=1e-15)
    assert "has positions: the eye moves within" in capsys.readouterr().out


# --- where samples lie ---

PLACES = np.random.default_rng(3).uniform(-1, 1, (FRAMES, 2)).round(3)


def places_in(file, rows=PLACES, head="x,y"):
    lines = [",".join(map(str, row)) for row in rows]
    file.write_text("\n".join([head, *lines, ""]))
    return file


@pytest.mark.parametrize("columns", ["x,y", "y, x"])
def test_places_of_samples_are_read_by_their_names(frames, tmp_path, columns):
    rows = PLACES if columns == "x,y" else PLACES[:, ::-1]
    file = places_in(tmp_path / "jitter.csv", rows, columns)
    technique, quiet = Shows("color", jitters=True), rich.console.Console(quiet=True)
    given = ChannelFolders(jitter=file).of_techniques(
        quiet, [technique], FrameFiles.of(frames), VIEW
    )
    np.testing.assert_allclose(given[0]["jitter_px"], PLACES, rtol=1e-6)
    found = displayed(frames, technique, jitter=file)
    np.testing.assert_allclose(found[:, 0, 0, 0], PLACES[:, 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("rows", "head", "message"),
    [
        (PLACES[1:], "x,y", "must have a row per frame (8), got 7."),
        (PLACES, "u,v", "columns must be x, y, got u, v."),
        ([*PLACES[1:], (0, 1.1)], "x,y", "row 8: y must lie in [-1, 1], got 1.1."),
        ([(0, "nan"), *PLACES[1:]], "x,y", "row 1: y must lie in [-1, 1], got nan."),
        ([(0, "a"), *PLACES[1:]], "x,y", "row 1: must be two numbers, got 0,a."),
        ([(0,), *PLACES[1:]], "x,y", "row 1: must be two numbers, got 0."),
        ([], "", "columns must be x, y, got ."),
    ],
)
def test_wrong_places_are_told_in_one_line(
    frames, tmp_path, capsys, rows, head, message
):
    file = places_in(tmp_path / "jitter.csv", rows, head)
    assert cli.run(["apply", "none", str(frames), "--jitter", str(file)]) == 2
    error = capsys.readouterr().err
    assert f"{file}: {message}" in error
    assert error.count("\n") == 1


def test_places_that_nobody_reads_or_names_are_said(frames, tmp_path, capsys):
    file = places_in(tmp_path / "jitter.csv")
    assert cli.run(["apply", "none", str(frames), "--jitter", str(file)]) == 0
    assert f"{file} is not used: no technique here reads it." in capsys.readouterr().out
