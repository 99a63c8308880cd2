"""Whatever the bytes and the words: an answer or one clear line, soon, and no files."""

import contextlib
import io
import signal
import warnings
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hmdjit as hj
from hmdjit import _toml, techniques
from hmdjit.cli import definition, fit, head, render, reproduce, trade_off
from hmdjit.cli import main as cli
from hmdjit.cli.options import Options
from hmdjit.head_motion import presets
from hmdjit.metrics import IDS as METRICS
from hmdjit.scenes import pictures

ROOT = Path(__file__).parents[1]
LONGEST_S = 20.0  # of processor time, for any input: more is a hang

# Of 10,000 cases in all.
TIERS = {
    name: pytest.mark.parametrize(
        "examples", [few, pytest.param(many, marks=pytest.mark.exhaustive)]
    )
    for name, few, many in [
        ("traces", 65, 3000),
        ("studies", 40, 2500),
        ("pictures", 70, 2500),
        ("arguments", 20, 2000),
    ]
}

SNIPPETS = [
    *(bytes([code]) for code in b"\0\n\r\t \"'#,;:=.-+[]{}eE019"),
    *(b"nan", b"inf", b"1e308", b"9" * 400, b"-1", b"null", b"true", b"\xff", b"\xef"),
    *(b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\0", "½\u2028".encode()),
]
edits = st.lists(
    st.tuples(
        st.floats(0, 1),
        st.sampled_from([0, 1, 1, 2, 8, 64]),
        st.one_of(st.sampled_from(SNIPPETS), st.binary(max_size=6)),
    ),
    min_size=1,
    max_size=5,
)


def mutated(seeds):
    """Bytes of one of some files, edited, cut short or grown."""

    def apply(whole, edits, end):
        for place, length, snippet in edits:
            start = int(place * len(whole))
            whole = whole[:start] + snippet + whole[start + length :]
        return whole[: int(end * len(whole))] if end < 1 else whole

    ends = st.one_of(st.just(1.0), st.just(1.0), st.floats(0, 1))
    return st.builds(apply, st.sampled_from(seeds), edits, ends)


def examine(examples, check, *strategies):
    """Check so many cases, each within its time."""

    def late(*_):
        raise AssertionError(f"took more than {LONGEST_S:g} s")

    @settings(
        max_examples=examples,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
        print_blob=False,
    )
    @given(st.tuples(*strategies))
    def one(case):
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        try:
            check(*case)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    usual = signal.signal(signal.SIGPROF, late)
    try:
        one()
    finally:
        signal.signal(signal.SIGPROF, usual)


def message_of(function, *arguments, errors=(ValueError, OSError)):
    """Call a function; return its error, which is one line, or None."""
    try:
        with warnings.catch_warnings(action="ignore"):
            function(*arguments)
    except errors as error:
        line = str(error)
        assert len(line.splitlines()) == 1, line
        return line
    return None


# --- recorded heads ---


def recorded():
    """A few rows of a recorded head, in the forms that are read."""
    text = (ROOT / "traces" / "fixating_90hz.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")][:8]
    rows = [line.split(",") for line in lines[1:]]
    logged = [
        f'{{"time": {row[0]}, "rotation": {{"w": {row[1]}, "x": {row[2]}, '
        f'"y": {row[3]}, "z": {row[4]}}}}}'
        for row in rows
    ]
    forms = ["\n".join(lines), "\n".join(lines).replace(",", ";").replace(".", ",")]
    forms += ["\n".join(logged), f"[{', '.join(logged)}]"]
    return [form.encode() for form in forms]


@TIERS["traces"]
def test_recorded_heads(examples, tmp_path, untyped):
    path = tmp_path / "me.csv"
    for whole in recorded():
        path.write_bytes(whole)
        assert len(hj.Trace.read(path).t_s) == 7

    def check(content):
        path.write_bytes(content)
        line = message_of(hj.Trace.read, path)
        assert line is None or line.startswith("me.csv")

    examine(examples, check, st.one_of(mutated(recorded()), st.binary(max_size=60)))


# --- study files ---

STUDY = b"""
scenes = ["noise"]
techniques = ["none", "msaa4", "head_movement"]
head = "seated"
sessions = 20
fov = 90.5
tile_size = 16
out = "out"
omit_failed = true
[head_movement]
w_min = 0.2
closeness = [0.5]
ease = { family = "cosine" }
"""
SWEEP = STUDY.replace(b"fov = 90.5\n", b"") + (
    b"[sweep]\nrefresh = [60, 72.5]\nfov = { from = 80, to = 110, steps = 3 }\n"
    b"head_movement.h_max_deg_s = [4, 8]\n"
)

numbers = st.one_of(
    st.integers(-3, 300),
    st.sampled_from([10**9, 10**30, -(10**18), 2**31, 0]),
    st.floats(),
    st.sampled_from([0.0, 1e-300, 1e300, 0.5, 90.0]),
)
strings = st.one_of(
    st.sampled_from([*techniques.IDS, *METRICS, *presets.tables(), "noise", "text"]),
    st.sampled_from(["", ".", "..", "/", "gone.toml", "head_movement:gone.toml", "5s"]),
    st.sampled_from(["none+ssaa2", "+", ":", "a b", "10m", "\n", "\x7f", "ssaa0"]),
    st.text(max_size=6),
)
plain = st.one_of(numbers, strings, st.booleans())
keys = st.one_of(
    st.sampled_from([name for name in Options.__dataclass_fields__]),
    st.sampled_from(["sweep", *techniques.IDS, "fovv", "Width"]),
    st.text(max_size=5),
)
fields = st.sampled_from(["w_min", "closeness", "ease", "family", "space", "from", "a"])
values = st.recursive(
    plain,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(fields, inner, max_size=3)
    ),
    max_leaves=4,
)


def spelled(table):
    return "\n".join(f"{_toml.key(k)} = {_toml.text(v)}" for k, v in table.items())


tables = st.dictionaries(keys, values, max_size=3).map(lambda t: spelled(t).encode())
added = st.tuples(st.sampled_from([STUDY, SWEEP]), tables).map(
    lambda pair: pair[1] + pair[0]
)


class Reached(KeyboardInterrupt):
    """All checks at the door are passed; what follows takes long."""


@pytest.fixture
def at_the_door(monkeypatch, tmp_path, untyped):
    """Commands stop where their work begins, in an empty folder."""

    def reached(*_, **__):
        raise Reached

    noise = {"noise": hj.scenes.power_law_noise(size=16)}
    monkeypatch.setattr(definition, "_scenes", lambda options: noise)
    monkeypatch.setattr(hj.scenes, "study_set", lambda: noise)
    for thing, name in [
        *((kind, "run") for kind in (hj.Study, hj.Sweep)),
        *((hj.HeadMotion, name) for name in ("sample",)),
        *((head.fitting, name) for name in ("fit_heads", "still_data")),
        (trade_off.measurement, "measure"),
        (fit, "fit"),
        (render, "_costs"),
        (render, "bake"),
        (render.Renderer, "__init__"),
        (reproduce.ReproduceCommand, "_run"),
    ]:
        monkeypatch.setattr(thing, name, reached)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def answer(arguments):
    """Run a command line; return its exit code, once what it says is checked."""
    said, complaint = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complaint):
        try:
            code = cli.run(arguments)
        except SystemExit as stop:  # tyro's own messages, in a box
            code, is_usage = stop.code, True
        else:
            is_usage = False
    lines = complaint.getvalue().splitlines()
    assert code in (0, 1, 2, 130), code
    assert "Traceback" not in said.getvalue() + complaint.getvalue()
    if not is_usage:
        assert len(lines) == (code != 0), lines
        assert all(line.startswith("hmdjit: ") for line in lines)
    return code


@TIERS["studies"]
def test_study_files(examples, at_the_door):
    path, out = at_the_door / "study.toml", at_the_door / "out"
    for command, content in (("study", STUDY), ("sweep", SWEEP)):
        path.write_bytes(content)
        assert answer([command, "study.toml"]) == 130

    def check(command, content):
        path.write_bytes(content)
        answer([command, "study.toml", "--out", "out"])
        assert sorted(at_the_door.iterdir()) == [path], "left behind"

    assert not out.exists()
    content = st.one_of(mutated([STUDY, SWEEP]), added, st.binary(max_size=40))
    examine(examples, check, st.sampled_from(["study", "sweep"]), content)


# --- pictures ---


def encoded():
    """Small pictures in many forms."""
    rng = np.random.default_rng(0)
    color = rng.integers(0, 256, (9, 12, 4), dtype=np.uint8)
    grey = PIL.Image.fromarray(rng.integers(0, 65536, (9, 12), dtype=np.uint16))
    opaque = PIL.Image.fromarray(color[..., :3])
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    cases = [
        *((opaque, form, {}) for form in ("PNG", "JPEG", "TIFF", "GIF", "BMP")),
        *((PIL.Image.fromarray(color), form, {}) for form in ("PNG", "TIFF", "WEBP")),
        *((grey, form, {}) for form in ("PNG", "TIFF")),
        (opaque.convert("CMYK"), "JPEG", {}),
        (opaque.convert("CMYK"), "TIFF", {"compression": "tiff_lzw"}),
        (opaque.quantize(7), "PNG", {"transparency": 3}),
        (opaque.convert("1"), "PNG", {}),
        (opaque, "JPEG", {"exif": exif, "progressive": True}),
        (opaque, "TIFF", {"compression": "tiff_deflate"}),
    ]
    found = []
    for image, form, options in cases:
        file = io.BytesIO()
        image.save(file, form, **options)
        found.append(file.getvalue())
    return found


@TIERS["pictures"]
def test_pictures(examples, tmp_path, untyped):
    path = tmp_path / "me.png"
    for whole in encoded():
        path.write_bytes(whole)
        assert pictures.read_picture(path).shape in ((9, 12, 3), (12, 9, 3))

    def check(content):
        path.write_bytes(content)
        line = message_of(read, content)
        assert line is None or line.startswith(f"{path}: ")

    def read(content):
        found = pictures.read_picture(path)
        assert found.ndim == 3
        assert found.min() >= 0
        assert found.max() <= 1

    examine(examples, check, mutated(encoded()))


# --- command lines ---

FILES = ["study.toml", "sweep.toml", "me.csv", "me.png", "gone", "frames", ".", "/"]
OPTIONS = [
    *(f"--{name.replace('_', '-')}" for name in Options.__dataclass_fields__),
    *("--help", "--version", "--from", "--technique", "--quick", "--seconds", "--hz"),
    *(
        "--scene",
        "--rate",
        "--poses",
        "--model",
        "--seed",
        "-h",
        "--",
        "-",
        "--sesions",
    ),
]
words = st.one_of(
    st.sampled_from(OPTIONS),
    st.sampled_from(OPTIONS),
    st.sampled_from(FILES),
    plain.map(str),
    st.text(max_size=4),
)
commands = st.one_of(
    st.sampled_from([[name] for name in cli.COMMANDS if name != "envelope"]),
    st.sampled_from([["head", name] for name in ("fit", "describe", "sample")]),
    st.sampled_from([["study", "study.toml"], ["sweep", "sweep.toml"], ["stdy"], []]),
)


@TIERS["arguments"]
def test_command_lines(examples, at_the_door):
    (at_the_door / "frames").mkdir()
    (at_the_door / "study.toml").write_bytes(STUDY)
    (at_the_door / "sweep.toml").write_bytes(SWEEP)
    (at_the_door / "me.csv").write_bytes(recorded()[0])
    (at_the_door / "me.png").write_bytes(encoded()[0])
    known = sorted(at_the_door.rglob("*"))

    def check(command, words):
        code = answer([*command, *words])
        if code:
            assert sorted(at_the_door.rglob("*")) == known, "left behind"
            return
        for made in set(at_the_door.rglob("*")) - set(known):
            made.unlink()

    examine(examples, check, commands, st.lists(words, max_size=5))
