import importlib
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import PIL.Image
import pytest
from PIL.PngImagePlugin import PngInfo

import hmdjit as hj

EXAMPLES = Path(__file__).parents[1] / "examples"
PICTURES = {
    "axes_of_a_head.py": (),
    "contact_sheet.py": ("--scenes", "pipe", "coffee", "--side", "96"),
    "ratio_against_correlation.py": ("--sessions", "4", "--crop", "16"),
}
# Their docstring has what the whole of them prints.
PRINTED = {
    "custom_technique.py": ("--sessions", "4"),
    "custom_scene.py": ("--sessions", "4"),
    "my_renderer.py": ("--frames", "8"),
    "my_trace.py": ("--sessions", "4"),
    "gradient_of_flicker.py": ("--heads", "2"),
    "on_a_cluster.py": ("--sessions", "4"),
}
SMALL = ("--width", "64", "--height", "64", "--fov", "8")
PAGES = {
    "all_techniques": (
        *("--pictures", "noise", "--solids", "pipe", "--grid-scenes", "noise"),
        *("--sessions", "4", "--solid-sessions", "2", "--grid-sessions", "4"),
        *("--presets", "fixating", "--rates", "60", "--temporal", "karis"),
        *("--keep", "{keep}"),
    ),
    "dynamic_regions": ("--sessions", "2", "--scenes", "fence"),
    "envelope": ("--csv", str(EXAMPLES / "envelope.csv")),
    "fitted_curves": (
        *("--heads", "fixating", "--rates", "60", "--scenes", "checkerboard"),
        *("--held-out", "none", "--sessions", "16", *SMALL),
    ),
    "ghosting": ("--side", "16", "--heads", "2", "--techniques", "karis"),
    "heads": (
        *("--traces", "{traces}", "--presets", "--order", "0"),
        *("--scenes", "noise", "--sessions", "4"),
    ),
    "reproductions": (
        *("--papers", "colour-space", "--sessions", "2", "--side", "24"),
        *("--readme", "{readme}"),
        *("--keep", "{keep}"),
    ),
    "sensitivities": ("--scenes", "noise", "--sessions", "4"),
    "speed": ("--json", "{speed}", "--drawn", "2000"),
    "static_edges": ("--scenes", "pipe", "--side", "32", "--poses", "2"),
    "techniques": (
        *("--sessions", "2", "--scenes", "noise", "--repeats", "1"),
        *("--techniques", "none", "msaa4", "fxaa10", "--readme", "{readme}"),
    ),
    "time_to_one_percent": ("--scenes", "noise", "--sessions", "4"),
    "trade_off": ("--quick", "--sessions", "4", "--width", "128", "--height", "128"),
}
BLOCK = re.compile(r"<!-- (?!end )(\w+) -->\n\n(.*?)\n\n<!-- end -->", re.S)


def _run(name, *options, timeout=600):
    command = [sys.executable, str(EXAMPLES / name), *options]
    done = subprocess.run(
        command,
        check=False,
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=EXAMPLES.parent,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def _cells(table):
    return [
        [cell.strip() for cell in line[1:-1].split("|")] for line in table.splitlines()
    ]


def _is_table(block):
    return block.startswith("| ")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """What the small forms of pages read, by the names in `PAGES`."""
    folder = tmp_path_factory.mktemp("inputs")
    traces = folder / "traces"
    traces.mkdir()
    head, t_s = hj.HeadMotion.fixating(), np.arange(20 * 90) / 90
    for person, key in enumerate(jax.random.split(jax.random.key(0), 4)):
        trace = hj.Trace(t_s, np.asarray(head.sample(key, 90.0, len(t_s)), float))
        trace.write(traces / f"sample_{person}_still.csv")
    entry = {"name": "hmdjit", "side": 64, "cores": 1, "ns_per_pixel_frame": 8.87}
    entries = [entry | {"times_as_fast": {"value": 4.1}}]
    entries.append(entries[0] | {"name": "OpenCV + NumPy", "ns_per_pixel_frame": 36.4})
    speed = folder / "speed.json"
    speed.write_text(json.dumps({"rivals": entries}), encoding="utf-8")
    readme = folder / "README.md"
    shutil.copy(EXAMPLES.parent / "README.md", readme)
    return {
        "traces": traces,
        "speed": speed,
        "readme": readme,
        "keep": folder / "keep",
    }


def test_every_example_is_run():
    scripts = {path.name for path in EXAMPLES.glob("*.py")}
    pages = {f"{name}.py" for name in PAGES}
    known = {*PICTURES, *PRINTED, *pages}
    assert scripts == known | {"quasi_random_paths.py", "pages.py", "docs.py"}
    texts = {"outgrowing_one_machine"}  # which no script fills
    assert {page.stem for page in EXAMPLES.glob("*.md")} == set(PAGES) | texts


@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_its_command_and_has_whole_tables(name):
    page = (EXAMPLES / f"{name}.md").read_text(encoding="utf-8")
    first = page.partition("\n")[0]
    command = re.match(r"\*Made by `(.+)`: hmdjit [\d.]+.*\.\*$", first)
    assert command is not None
    assert shlex.split(command[1])[:2] == ["python", f"examples/{name}.py"]
    tables = [block for _, block in BLOCK.findall(page) if _is_table(block)]
    assert tables
    for table in tables:
        assert len({len(row) for row in _cells(table)}) == 1


@pytest.fixture
def pages(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    yield importlib.import_module("pages")
    del sys.modules["pages"]


def test_old_pages_and_pictures_are_known(pages, tmp_path):
    now, before = pages.made_by(), "hmdjit 0.1.0, model 4"
    for name, made in {"heads": now, "trade_off": before, "speed": before}.items():
        (tmp_path / f"{name}.md").write_text(f"*Made by `python x`: {made}, JAX 0.*\n")
        picture = PngInfo()
        picture.add_text("Source", made)
        file = tmp_path / f"{name}.png"
        PIL.Image.new("L", (2, 2)).save(file, pnginfo=picture)
    unstamped = [pages.STUDY, pages.SCENES]  # of times before any stamp
    for name in unstamped:
        PIL.Image.new("L", (2, 2)).save(tmp_path / name)
    assert pages.old(tmp_path) == [*unstamped, "trade_off.md", "trade_off.png"]


def test_verdicts_of_several_seeds_stand_in_one_row(pages):
    reproductions = importlib.import_module("reproductions")
    known = {"claim": "it flickers less", "measure": "MTCD", "source": "figure 3"}
    known |= {"quantity": "ratio", "unit": "", "value": "0.6", "low": "0.5"}
    said = [known | {"high": "0.7", "verdict": v} for v in ("holds", "untold", "holds")]
    other = [row | {"measure": "SSIM", "verdict": "holds"} for row in said]
    found = {"paper": [said, other]}
    *_, row = reproductions.verdicts(found).splitlines()
    assert row == (
        "| paper | it flickers less | 0.6 [0.5, 0.7] | "
        "holds (2 of 3 seeds), untold (1) |"
    )
    rows = reproductions.measures(found).splitlines()
    assert len(rows) == 2 + 2
    *_, row = reproductions.overview(found).splitlines()
    assert row == "| paper | - | - | it flickers less (0.6 [0.5, 0.7]) |"
    assert "| SSIM | ratio | " + "; ".join(3 * ["0.6 [0.5, 0.7]"]) in rows[-1]
    assert rows[-1].endswith("| holds (3 of 3 seeds) |")


def test_the_readmes_pictures_are_of_this_model(pages):
    assert not pages.is_old(EXAMPLES / pages.STUDY)
    assert not pages.is_old(EXAMPLES / pages.SCENES)


LONG = {
    "heads",
    "fitted_curves",
    "all_techniques",
    "reproductions",
}  # minutes, in their smallest form
MARKED = [
    pytest.param(n, marks=[pytest.mark.exhaustive if n in LONG else pytest.mark.slow])
    for n in PAGES
]


@pytest.mark.parametrize("name", MARKED)
def test_a_page_has_the_form_that_its_command_writes(name, inputs, tmp_path):
    out = tmp_path / f"{name}.md"
    options = [option.format_map(inputs) for option in PAGES[name]]
    _run(f"{name}.py", *options, "--out", str(out))
    written, kept = (
        path.read_text(encoding="utf-8") for path in (out, EXAMPLES / f"{name}.md")
    )
    _, _, rest = written.partition("\n")
    _, _, known = kept.partition("\n")
    assert BLOCK.sub(r"\1", rest) == BLOCK.sub(r"\1", known)
    known_blocks = dict(BLOCK.findall(kept))
    for block, text in BLOCK.findall(written):
        assert _is_table(text) == _is_table(known_blocks[block])
        if not _is_table(text):
            continue
        ours, theirs = _cells(text), _cells(known_blocks[block])
        assert len(ours) > 2
        if block == "held_out":  # its columns are the sets of recordings
            assert [row[0] for row in ours] == [row[0] for row in theirs]
        else:
            assert ours[0] == theirs[0]
    globals().get(f"_check_{name}", lambda blocks: None)(dict(BLOCK.findall(written)))


def _check_envelope(blocks):
    assert blocks == dict(BLOCK.findall((EXAMPLES / "envelope.md").read_text("utf-8")))


def _check_fitted_curves(blocks):
    (row,) = _cells(blocks["heads"])[2:]
    assert row[0] == "fixating, 60 Hz"
    for cell in row[1:-1]:
        best, low, high = (float(x.strip("[],")) for x in cell.split())
        assert low <= best <= high


def _check_sensitivities(blocks):
    # More weight on the current picture leaves more of its flicker.
    slopes = {row[0]: row[1] for row in _cells(blocks["numbers"])[2:]}
    assert float(slopes["technique.w_min"]) > 0


def _check_speed(blocks):
    rows = {row[0]: row[1:] for row in _cells(blocks["pipeline"])[2:]}
    assert rows["hmdjit"] == ["8.9 (4.1 x)", "", "", "", ""]
    assert rows["OpenCV + NumPy"][0] == "36.4"


def _check_time_to_one_percent(blocks):
    (row,) = _cells(blocks["seconds"])[2:]
    assert row[0] == "noise"
    assert float(row[1].replace(",", "")) > float(row[2]) > 0


def _check_trade_off(blocks):
    biases = {row[0].strip("*"): row[1] for row in _cells(blocks["settings"])[2:]}
    assert float(biases["reference"].split()[0]) == 0


@pytest.mark.slow
def test_quasi_random_paths_are_surer():
    row = (
        _run("quasi_random_paths.py", "--scenes", "noise").splitlines()[-1].split(", ")
    )
    assert row[0] == "noise"
    # A gain of 3 is below 1 in 48 replicates each with probability 1e-4.
    assert float(row[2].split()[0]) > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURES)
def test_examples_write_their_picture(name, tmp_path):
    out = tmp_path / "picture.png"
    _run(name, *PICTURES[name], "--out", str(out), timeout=300)
    assert out.stat().st_size > 10_000


NUMBER = re.compile(r"-?\d[\d.]*(?:e-?\d+)?")


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTED)
def test_examples_print_what_they_say(name):
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    about = text.split('"""')[1]
    found = re.search(r"\n    (python .*)\n\nprinted\n\n((?:    .*\n)+)", about)
    assert found is not None
    command, told = found.groups()
    assert command == f"python examples/{name}"
    printed = _run(name, *PRINTED[name])
    form = lambda output: NUMBER.sub("0", " ".join(output.split()))
    assert form(printed) == form(told)
    assert NUMBER.findall(printed) != NUMBER.findall(told)  # in small: other numbers
    globals().get(f"_check_{name[:-3]}", lambda printed: None)(printed)


def _check_my_renderer(printed):
    rendered, shown, more = (
        float(line.split(":")[1].split()[0]) for line in printed.splitlines()
    )
    assert rendered > shown > more > 0


def _check_gradient_of_flicker(printed):
    exact, difference = map(float, NUMBER.findall(printed.splitlines()[-1]))
    assert exact == pytest.approx(difference, rel=0.01)


def _check_on_a_cluster(printed):
    assert "same bits as here: True" in printed
