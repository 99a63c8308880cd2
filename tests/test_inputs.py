"""What comes in from files may lie: it is refused in plain words, and stays put."""

import ast
import io
import os
import pickle
import resource
import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from test_architecture import TREES

import hmdjit as hj
from hmdjit import scenes
from hmdjit.cli import definition, frame_channels
from hmdjit.cli import main as cli
from hmdjit.scenes import pictures
from hmdjit.simulation.session import Result
from hmdjit.studies import runner
from hmdjit.studies.store import Store

SIDE = 50_000  # 7.5 GB of pixels


def chunk(kind, content):
    whole = kind + content
    return (
        struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))
    )


def png(width, height, bits=8, color=2, rows=b""):
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    body = chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + body


def encoded(form, picture, **options):
    file = io.BytesIO()
    PIL.Image.fromarray(picture).save(file, form, **options)
    return file.getvalue()


def claiming(width, height):
    """Small files of several forms whose headers claim another size."""
    small = np.full((6, 8, 3), 90, np.uint8)
    jpeg = bytearray(encoded("JPEG", small))
    at = jpeg.index(b"\xff\xc0") + 5
    jpeg[at : at + 4] = struct.pack(">HH", height, width)
    bmp = bytearray(encoded("BMP", small))
    bmp[18:26] = struct.pack("<ii", width, height)
    gif = bytearray(encoded("GIF", small))
    gif[6:10] = struct.pack("<HH", width, height)
    at = gif.index(b",") + 5
    gif[at : at + 4] = struct.pack("<HH", width, height)
    tiff = bytearray(encoded("TIFF", small))
    (directory,) = struct.unpack("<I", tiff[4:8])
    for place in range(directory + 2, len(tiff) - 11, 12):
        tag, kind = struct.unpack("<HH", tiff[place : place + 4])
        if tag in (256, 257, 278) and kind in (3, 4):
            value = width if tag == 256 else height
            form = {3: "<HH", 4: "<I"}[kind]
            packed = struct.pack(form, *([value, 0] if kind == 3 else [value]))
            tiff[place + 8 : place + 12] = packed
    kept = {"png": png(width, height), "jpg": jpeg, "bmp": bmp, "gif": gif, "tif": tiff}
    return {f"me.{ending}": bytes(content) for ending, content in kept.items()}


@pytest.mark.parametrize("name", list(claiming(9, 9)))
def test_a_header_of_gigabytes_is_refused_before_they_are_allocated(name, file):
    path = file(claiming(SIDE, SIDE)[name], name)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=r"me\.\w+: too large: .*2500000000 pixels"):
        pictures.read_picture(path)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert after - before < 100_000  # kB


def test_a_jpeg_cannot_claim_what_its_bytes_cannot_hold(file):
    path = file(claiming(4000, 3000)["me.jpg"], "me.jpg")
    with pytest.raises(ValueError, match=r"me\.jpg: claims 4000 x 3000 px, too"):
        pictures.read_picture(path)
    even = encoded("JPEG", np.full((3000, 4000), 90, np.uint8), quality=1)
    assert pictures.read_picture(file(even, "me.jpg")).shape == (3000, 4000, 3)


@pytest.mark.parametrize("name", ["me.png", "me.bmp", "me.tif"])
def test_a_picture_smaller_than_its_header_says_is_damaged(name, file):
    path = file(claiming(800, 600)[name], name)
    with pytest.raises(ValueError, match=rf"^{path}: damaged or unreadable: "):
        pictures.read_picture(path)


def test_ink_is_read_as_light(file, rng):
    picture = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    ink = io.BytesIO()
    PIL.Image.fromarray(picture).convert("CMYK").save(ink, "TIFF")
    found = pictures.read_picture(file(ink.getvalue(), "ink.tif"))
    np.testing.assert_allclose(255 * found, picture, atol=1.01)


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (pickle.dumps(print), "me.npy", "cannot be read as NPY"),
        (b"\x93NUMPY\x01\x00", "me.npy", "cannot be read as NPY"),
        (b"x", "me.png", "cannot be read"),
        (png(SIDE, SIDE, 16, 0), "me.png", "cannot be read .*decompression bomb"),
        (png(4, 4, 16, 0, b"\0"), "me.png", "cannot be read"),
    ],
)
def test_channels_that_lie_are_refused(content, name, message, file):
    path = file(content, name)
    with pytest.raises(ValueError, match=rf"^{path}: {message}"):
        frame_channels._read(path, "depth")


def test_a_numpy_file_may_claim_no_more_than_it_holds(file):
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (SIDE, SIDE)}
    np.lib.format.write_array_header_1_0(header, shape)
    path = file(header.getvalue() + bytes(64), "me.npy")
    with pytest.raises(ValueError, match=r"me\.npy: cannot be read as NPY"):
        frame_channels._read(path, "depth")
    objects = io.BytesIO()
    np.save(objects, np.array([print, len]), allow_pickle=True)
    path.write_bytes(objects.getvalue())
    with pytest.raises(ValueError, match=r"me\.npy: cannot be read as NPY"):
        frame_channels._read(path, "depth")
    np.save(path, np.eye(3))
    np.testing.assert_array_equal(frame_channels._read(path, "depth"), np.eye(3))


def test_a_batch_of_objects_counts_as_unfinished(tmp_path):
    store = Store(tmp_path)
    store.keep("noise", "key", 0, {"one": Result({"mtcd": np.ones(3)})})
    (path,) = (tmp_path / "batches").iterdir()
    assert list(store.found("noise", "key"))
    np.savez(path, allow_pickle=True, **{"one.mtcd": np.array([print, len])})
    assert not list(store.found("noise", "key"))


RUNS_WHAT_IT_READS = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib"}
SENDS_STUDIES = "studies.executors"  # to workers, and reads no file


def test_nothing_that_is_read_is_run():
    nodes = [(name, node) for name in TREES for node in ast.walk(TREES[name])]
    for name, node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom) and name != SENDS_STUDIES:
            named = {alias.name.split(".")[0] for alias in node.names}
            named.add((getattr(node, "module", None) or "").split(".")[0])
            assert not named & RUNS_WHAT_IT_READS
        if isinstance(node, ast.Call):
            assert getattr(node.func, "id", "") not in ("eval", "exec", "__import__")
            for option in node.keywords:
                if option.arg == "allow_pickle":  # NumPy's default of loading is False
                    assert isinstance(option.value, ast.Constant)
                    assert option.value.value is False


# --- study files ---


def test_the_names_of_scenes_are_those_of_the_study_set():
    every = [*scenes.study_set(), *scenes.solid_set()]
    assert tuple(dict.fromkeys(every)) == scenes.NAMES


STUDY = """
scenes = ["noise", "beside.png"]
head = "seated"
techniques = ["none", "head_movement:mine.toml"]
baseline = "none"
width = 64
height = 64
fov = 8
tiles = 1
sessions = 4
frames = 3
warmup = 1
out = "there"
"""
_WATCHED: list[set[Path]] = []


def _watch(event, arguments):
    if _WATCHED and event == "open" and isinstance(arguments[0], str | bytes | Path):
        _WATCHED[-1].add(Path(os.fsdecode(arguments[0])).absolute())


def test_a_study_reads_and_writes_only_what_it_names(tmp_path, monkeypatch, rng):
    def run(self, techniques, source, batch):
        value = 1.0 + np.arange(batch.size)
        return [Result({"mtcd": value, "detail_loss": value}) for _ in techniques]

    monkeypatch.setattr(runner.Runner, "run", run)
    folder, elsewhere = tmp_path / "studies", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    picture = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    PIL.Image.fromarray(picture).save(folder / "beside.png")
    (folder / "mine.toml").write_text("[head_movement]\nw_min = 0.2\n")
    (folder / "study.toml").write_text(STUDY)
    # None of these is meant by a name that is known.
    for place in (folder, elsewhere):
        for name in ("noise", "seated", "none", "noise.png", "seated.toml"):
            (place / name).write_text("not this one")
    monkeypatch.chdir(elsewhere)
    before = set(tmp_path.rglob("*"))
    sys.addaudithook(_watch)  # for good: it sleeps outside of this test
    _WATCHED.append(set())
    try:
        options, tables = definition.read_toml(folder / "study.toml")
        study = definition.build(options, tables)
        assert list(study.scenes) == ["noise", "beside"]
        assert study.head == hj.HeadMotion.preset("seated")
        assert cli.run(["study", str(folder / "study.toml")]) == 0
    finally:
        opened = _WATCHED.pop()
    made = set(tmp_path.rglob("*")) - before
    assert made
    assert all(path.is_relative_to(folder / "there") for path in made)
    assert {path for path in opened & before if path.is_file()} == {
        folder / name for name in ("study.toml", "beside.png", "mine.toml")
    }


@pytest.mark.parametrize("name", ["../../evil", "/evil", "a\\..\\b", "..", "con:"])
def test_a_scene_of_any_name_keeps_its_batches_in_the_folder(name, tmp_path):
    store = Store(tmp_path / "out")
    store.keep(name, "key", 0, {"one": Result({"mtcd": np.ones(3)})})
    (path,) = (path for path in tmp_path.rglob("*") if path.is_file())
    assert path.parent == tmp_path / "out" / "batches"
