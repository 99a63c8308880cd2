import base64
import io
import json
import math
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import PIL.Image
import pytest
import small
import xarray
from html_pages import Page, checked

import hmdjit as hj
from hmdjit import quaternion
from hmdjit.cli import kept
from hmdjit.cli import main as cli
from hmdjit.cli.definition import build, read_toml
from hmdjit.cli.options import Options
from hmdjit.estimates.summary import summarize
from hmdjit.figures import displayed as figures
from hmdjit.figures import drawing
from hmdjit.figures.techniques import Compared
from hmdjit.pages import apply as applied
from hmdjit.pages import displayed, markup
from hmdjit.pages import study as pages
from hmdjit.reports.tables import WORDS, table
from hmdjit.studies.identity import definition
from hmdjit.studies.stage import drawing as sessions_of

HOSTILE = "</script><b>&'\""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A study, its folder, and its page, drawn coarsely."""
    study = small.study(scenes={HOSTILE: small.NOISE}, sessions=6)
    folder = tmp_path_factory.mktemp("study")
    dataset = study.run(3, out=folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "DPI", 30)
        patch.setattr(drawing, "save_both", lambda f, path: [drawing.save(f, path)])
        patch.setattr(displayed, "FRAMES", 8)
        pages.write_page(dataset, folder, study, command="hmdjit study <x>")
    return study, folder, dataset


def test_a_page_is_self_contained_and_described(found):
    _, folder, _ = found
    page = checked(folder / "report.html")
    assert HOSTILE in page.said  # as words alone
    assert "hmdjit study <x>" in page.said
    headings = {"Question and answer", "Flicker viewer", "Heads", "Identity"}
    assert all(heading in page.said for heading in headings)
    assert len(page.of("figure")) == 8


def test_the_answer_is_that_of_the_table(found):
    _, folder, dataset = found
    page = checked(folder / "report.html")
    none, moved = dataset["mtcd"].values[:, 0].mean(axis=-1)
    assert f"Displayed by none, MTCD is {none:.3g} [" in page.said
    assert f"head_movement leaves {moved / none:.3g} [" in page.said
    assert "1 scene and 6 sessions" in page.said


def test_the_viewer_has_the_frames_without_loss(found, monkeypatch):
    monkeypatch.setattr(displayed, "FRAMES", 8)
    study, folder, _ = found
    clips = checked(folder / "report.html").clips
    shown = displayed.displayed(study, 3, HOSTILE, ["none", "head_movement"], 6)
    assert (clips["frames"], clips["width"], clips["height"]) == (8, 64, 64)
    for name, clip in shown.clips.items():
        uri = clips["sprites"][clips["names"][name]]
        with PIL.Image.open(io.BytesIO(base64.b64decode(uri.split(",")[1]))) as sprite:
            codes = np.asarray(sprite).reshape(8, 64, 64, 3)
        assert np.abs(codes - 255 * clip[:8]).max() <= 0.5 + 1e-3


def test_displayed_frames_flicker_as_a_simulated_session_does(monkeypatch):
    monkeypatch.setattr(displayed, "FRAMES", 8)
    study = small.study()
    shown = displayed.displayed(study, 3, "noise", ["none", "head_movement"], 12)
    drawn = sessions_of(small.study(frames=8), 3)(256).batch(0, 256).motion
    assert shown.motion.offset.shape[0] == 12  # the study's own, and no others
    np.testing.assert_array_equal(shown.motion.offset, drawn.offset[:12])
    offset = drawn.offset[shown.session]
    poses = jax.vmap(quaternion.exp)(jnp.asarray(offset))
    texture = hj.scenes.bake(small.NOISE, study.camera, oversampling=1, margin_deg=4.0)
    for technique in study.techniques:
        result = hj.simulate(
            texture, study.camera, technique, poses, warmup=study.warmup
        )
        flicker = displayed.flicker_map(shown.clips[technique.id])
        # Poses went through quaternions in float32.
        np.testing.assert_allclose(flicker.mean(), result.mtcd, rtol=2e-3)


@pytest.mark.parametrize(("at_hz", "power"), [(10, 3.0**2 / 2), (32, 3.0**2)])
def test_a_spectrum_holds_the_power_where_it_is(at_hz, power):
    time_s = np.arange(64) / 64
    wave = 3.0 * np.cos(2 * np.pi * at_hz * time_s)  # at most from frame to frame
    hz, density = displayed.spectrum(wave, 64.0)
    assert hz[np.argmax(density)] == at_hz
    np.testing.assert_allclose(density.sum() * hz[0], power, rtol=1e-6)


@pytest.mark.parametrize("side", [8, 12, 16])
def test_octaves_have_as_many_names_as_changes(side):
    clip = np.zeros((3, side, side, 3))
    edges, change = displayed.change_by_octave(clip, 10.0)
    assert len(figures.band_names(edges)) == len(change)


def test_changes_lie_in_the_octave_of_their_grating():
    x = np.arange(64)
    grating = np.sin(2 * np.pi * x * 6 / 64)  # of 10 px per degree: 0.94 cycles
    clip = np.zeros((3, 64, 64, 3))
    clip[1] = 0.1 * grating[:, None]
    edges, change = displayed.change_by_octave(clip, 10.0)
    octave = np.searchsorted(edges, 10.0 * 6 / 64) - 1
    assert np.argmax(change) == octave
    expected = 25.5 * np.sqrt(3 / 2)  # of three colours
    np.testing.assert_allclose(np.sqrt(np.sum(change**2)), expected, rtol=1e-3)
    assert change[octave] > 0.95 * expected


@pytest.mark.parametrize(
    ("study", "reason"),
    [(None, pages.UNKNOWN), (small.study(warmup=1), "other than in the result:")],
)
def test_what_cannot_be_simulated_is_said(found, tmp_path, monkeypatch, study, reason):
    monkeypatch.setattr(drawing, "DPI", 30)
    monkeypatch.setattr(drawing, "save_both", lambda f, path: [drawing.save(f, path)])
    _, _, dataset = found
    pages.write_page(dataset, tmp_path, study)
    page = checked(tmp_path / "report.html")
    assert f"are left out: {reason}" in page.said
    assert not [a for a, _ in page.of("div") if a.get("class") == "viewer"]
    with pytest.raises(ValueError, match="scene must be one of"):
        pages.write_page(dataset, tmp_path, study, scene="lost")


def test_a_failure_to_simulate_costs_no_report(found, tmp_path, monkeypatch):
    def fails(*_):
        raise RuntimeError("out of memory")

    monkeypatch.setattr(drawing, "DPI", 30)
    monkeypatch.setattr(drawing, "save_both", lambda f, path: [drawing.save(f, path)])
    monkeypatch.setattr(pages, "simulated", fails)
    study, _, dataset = found
    pages.write_page(dataset, tmp_path, study)
    page = checked(tmp_path / "report.html")
    assert "are left out: RuntimeError: out of memory." in page.said
    assert (tmp_path / "summary.csv").exists()


@pytest.mark.parametrize(
    ("better", "said"),
    [("less", "low leaves 0.5 of it, the least"), ("more", "high has 0.8 of it, the")],
)
def test_the_answer_is_the_best_whichever_way_a_metric_goes(better, said):
    values = np.array([1.0, 0.5, 0.8])[:, None, None] * np.ones((3, 1, 4))
    dataset = xarray.Dataset(
        {"ssim": (("technique", "scene", "session"), values, {"better": better})},
        {"technique": ["none", "low", "high"], "scene": ["a"], "session": range(4)},
        {"baseline": "none", "metrics": ["ssim"]},
    )
    compared = Compared(dataset, summarize(dataset))
    answer = " ".join(pages._answer(dataset, compared, pages._best(compared)))
    assert said in answer
    assert "etail loss" not in answer


def test_a_viewer_keeps_as_many_frames_as_fit(monkeypatch):
    noise = np.random.default_rng(0).random((12, 16, 16, 3))
    clips = {"a": noise, "b": noise.copy(), "c": 1 - noise}
    monkeypatch.setattr(markup, "CLIPS_BYTES", 12_000)
    known = Page(markup.viewer(clips, 60.0, ("a", "c"))).clips
    assert 2 < known["frames"] < 12
    assert known["names"] == {"a": "a", "b": "a", "c": "c"}
    assert known["sprites"].keys() == {"a", "c"}


def test_tables_have_headers_and_sections():
    text = markup.table(table({"<a>": WORDS, "n": "{:.1f}"}, [("x", 1.0), None]), "c")
    assert '<th scope="col" class="words">&lt;a&gt;</th>' in text
    assert '<th scope="row" class="words">x</th><td>1.0</td>' in text
    assert text.count("<tbody>") == 2


def test_a_definition_is_kept_and_read_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ramp = np.tile(np.arange(64, dtype=np.uint8) * 4, (64, 1))
    PIL.Image.fromarray(ramp).save("ramp.png")
    said = Options(
        images=(kept.Path("ramp.png"),),
        techniques=("none", "head_movement"),
        **{"width": 64, "height": 64, "fov": 8.0, "tiles": 1, "budget": "5m"},
        **{"out": kept.Path("x"), "overwrite": True, "omit_failed": True},
    )
    file = tmp_path / "mine.toml"
    file.write_text("[head_movement]\nw_min = 0.2\ncloseness = [0.5, 0.7]\n")
    _, tables = read_toml(file)
    folder = tmp_path / "there"
    folder.mkdir()
    options, read = read_toml(kept.keep(said, file, folder))
    assert read.keys() == tables.keys()
    assert options.images == (tmp_path / "ramp.png",)
    assert (options.budget, options.repeat) == (None, folder / "result.nc")
    assert not options.overwrite
    again = kept.kept(folder)
    assert again is not None
    one, other = (definition(s, 0, None) for s in (build(said, tables), again))
    assert one == other
    assert kept.kept(tmp_path) is None


@pytest.mark.parametrize("content", [None, b"no NetCDF", {}, {"metrics": ["mtcd"]}])
def test_a_folder_without_a_result_is_refused_in_one_line(content, tmp_path, capsys):
    if isinstance(content, bytes):
        (tmp_path / "result.nc").write_bytes(content)
    elif content is not None:
        mtcd = {"mtcd": (("technique", "session"), np.ones((1, 4)))}
        other = xarray.Dataset(mtcd, attrs={"baseline": "none"} | content)
        other.to_netcdf(tmp_path / "result.nc", engine="h5netcdf")
    assert cli.run(["report", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "result" in line


def test_apply_writes_a_page_and_a_clip(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drawing, "DPI", 30)
    rng = np.random.default_rng(0)
    for folder in ("frames", "reference"):
        kept.Path(folder).mkdir()
        for k in range(small.FRAMES):
            codes = rng.integers(0, 256, small.SIZE, dtype=np.uint8)
            PIL.Image.fromarray(codes).save(f"{folder}/f_{k}.png")
    options = ["--techniques", "freeze", "--reference", "reference", "--out", "out"]
    assert cli.run(["apply", "none", "frames", *options, "--warmup", "2"]) == 0
    page = checked(tmp_path / "out/report.html")
    assert "hmdjit apply none frames" in page.said
    assert "--warmup 2" in page.said
    assert re.search(r"freeze takes MTCD from (\d+) to 0 code values", page.said)
    assert len(page.of("figure")) == 3
    assert page.clips["frames"] == small.FRAMES - 2
    with PIL.Image.open(tmp_path / "out/before_after.webp") as clip:
        assert clip.size == (2 * small.WIDTH, small.HEIGHT)
        assert getattr(clip, "n_frames") == small.FRAMES - 2  # noqa: B009


def test_frames_that_do_not_flicker_have_no_ratio():
    rows = {"frames": {"mtcd": 0.0}, "karis": {"mtcd": 0.0, "mtcd_ratio": math.nan}}
    said = " ".join(applied._answer(rows, "frames", ["karis"]))
    assert said == "MTCD 0 before: no flicker to remove."


# Virtual time, in which a page without a screen is read, gives no frames to animate.
_CLOCK = """<script>
  window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 8);
  window.cancelAnimationFrame = clearTimeout;
</script></head>"""
_PROBE = """<script>addEventListener("load", async () => {
  const viewer = document.querySelector(".viewer"), found = {};
  const press = (name) => viewer.querySelector(`[data-do="${name}"]`).click();
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const canvas = viewer.querySelector(".zoom");
  const pixels = () => canvas.toDataURL();
  const changes = async () => {
    const seen = new Set();
    for (let k = 0; k < 12; k++) { seen.add(viewer.dataset.frame); await wait(83); }
    return seen.size > 1;
  };
  await wait(1500);
  found.begins = await changes();
  if (!found.begins) press("play");
  found.plays = await changes();
  press("play");
  found.pauses = !(await changes());
  const frame = viewer.dataset.frame, before = pixels();
  press("step");
  found.steps = viewer.dataset.frame !== frame && pixels() !== before;
  press("back");
  found.returns = viewer.dataset.frame === frame && pixels() === before;
  found.loaded = performance.getEntriesByType("resource")
    .map((entry) => entry.name).filter((name) => !name.startsWith("data:"));
  document.body.dataset.found = JSON.stringify(found);
});</script></body>"""


@pytest.mark.slow
@pytest.mark.parametrize("still", [False, True], ids=["motion", "reduced motion"])
def test_the_viewer_plays_pauses_and_steps_in_a_browser(found, tmp_path, still):
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        pytest.skip("no Chromium is installed")
    _, folder, _ = found
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = tmp_path / "page.html"
    text = text.replace("</head>", _CLOCK).replace("</body>", _PROBE)
    page.write_text(text, encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"]
    flags += ["--disable-background-networking", "--disable-component-update"]
    flags += ["--disable-sync", "--host-resolver-rules=MAP * ~NOTFOUND"]
    flags += ["--enable-logging=stderr", f"--user-data-dir={tmp_path / 'user'}"]
    flags += ["--force-prefers-reduced-motion"] * still
    flags += ["--virtual-time-budget=8000", "--dump-dom", page.as_uri()]
    run = subprocess.run([browser, *flags], capture_output=True, text=True, timeout=120)
    assert ":CONSOLE" not in run.stderr
    probed = re.search(r'data-found="(.*?)"', run.stdout)
    assert probed is not None, run.stderr
    known = json.loads(probed[1].replace("&quot;", '"'))
    assert known.pop("loaded") == []
    assert known.pop("begins") != still
    assert all(known.values()), known


@pytest.mark.slow
def test_a_study_writes_its_page_and_report_writes_it_again(tmp_path, capsys):
    arguments = ["--width", "64", "--height", "64", "--fov", "8", "--tiles", "1"]
    arguments += ["--scenes", "noise", "fence", "--sessions", "6", "--frames", "3"]
    arguments += ["--techniques", "none", "msaa4", "head_movement", "--warmup", "1"]
    out = tmp_path / "out"
    assert cli.run(["study", *arguments, "--out", str(out)]) == 0
    page = checked(out / "report.html")
    assert f"hmdjit study {out}/repeat.toml" in page.said
    for name in ("flicker_map", "differences", "spectra", "head", "ratios"):
        for kind in ("png", "svg"):
            assert (out / f"{name}.{kind}").stat().st_size > 5000
    # Solids, too; and the same folder again.
    assert cli.run(["report", str(out), "--scene", "fence"]) == 0
    assert "One session on fence" in checked(out / "report.html").said
    again = ["study", str(out / "repeat.toml"), "--out", str(tmp_path / "again")]
    assert cli.run([*again, "--no-report"]) == 0
    tables = [
        (folder / "summary.csv").read_bytes() for folder in (out, tmp_path / "again")
    ]
    assert tables[0] == tables[1]
    assert not (tmp_path / "again/report.html").exists()
