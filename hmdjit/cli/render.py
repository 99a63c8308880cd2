"""The command line's `hmdjit scenes`, `techniques` and `render`: what there is."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import rich.console
import tyro
from jaxtyping import Array, Shaped

from .. import _checks, scenes, techniques
from .._files import check_can_write, written_atomically
from .._types import Rgb
from ..camera import Camera, Region
from ..frames.frame import CHANNELS, MOTION_CLASSES
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from ..rendering import render
from ..reports import tables
from ..scenes.baking import bake
from ..scenes.solid_set import fence
from ..scenes.solids import Solids
from ..simulation.session import fastest_reading
from ..simulation.simulate import check_gives
from ..simulation.views import Pattern, Renderer
from ..studies.definition import StudyScene
from ..studies.identity import counted
from ..studies.progress import Progress
from ..technique_contract.base import AbstractTechnique
from ..trade_off import cost
from . import definition
from .frame_files import Codes, codes
from .options import OK, Fov, Height, Width, shown
from .progress import Display


@dataclasses.dataclass(frozen=True)
class ScenesCommand:
    """List the scenes that have a name: what each is, and what it gives techniques.

    The first eleven are the default study's. A study takes any of them by `--scenes`.

    For example: hmdjit scenes
    """

    def run(self, console: rich.console.Console) -> int:
        """Print a line for each scene."""
        for name in scenes.NAMES:
            scene = scenes.by_name(name)
            kind, size, moves = _about(scene)
            gives = " ".join(sorted(scene.gives))
            console.out(f"{name:16} {kind:8} {size:26} {moves:6} gives {gives}")
        return OK


_COMPOSED = """\
An id says what is not a technique's default: ssaa6, accumulation64, fxaa25, smaa_ultra;
_gamma or _linear, where colours are mixed; _no_jitter, last, where samples would move.
head_movement+ssaa2 resolves the samples of another first, head_movement:FILE.toml has
numbers from a file, my_taa.py:MyTAA is a class of your own; none+sharpen is a stage of
display, which follows any of them."""


@dataclasses.dataclass(frozen=True)
class TechniquesCommand:
    """List the techniques that have an id: whose, how they sample, what they need.

    Jitter is optional where a frame's samples lie elsewhere than in the last one unless
    the id says no. A study takes any of them by `--techniques`.

    For example: hmdjit techniques karis my_taa.py:MyTAA --cost
    """

    ids: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        shown("[ID...]", "Ids, any that there are (default: all that are listed)."),
    ] = ()
    cost: Annotated[
        bool,
        shown(
            "",
            "Measure, some seconds each: ns per pixel and frame of a picture, rendered "
            "and measured by MTCD; and what channels cost beside the colour of solids.",
        ),
    ] = False

    def run(self, console: rich.console.Console) -> int:
        """Print a table."""
        chosen = [techniques.by_id(id) for id in self.ids or techniques.IDS]
        columns = ["technique", "paper", "jitter", "samples", "needs"]
        rows = [list(_described(technique)) for technique in chosen]
        if self.cost:
            columns += ["picture, ns", "channels, ns"]
            for row, found in zip(rows, _costs(chosen, console), strict=True):
                row += [f"{ns:.3g}" for ns in found]
        words, say = dict.fromkeys(columns, tables.WORDS), tables.spelling(console)
        console.print(tables.table(words, rows, say=say))
        console.out(_COMPOSED)
        return OK


def _described(technique: AbstractTechnique) -> Iterator[Any]:
    """Cells of a technique, but for its cost."""
    period, samples, _ = technique.sample_offsets_px.shape
    yield technique.id
    yield technique.paper or None
    inner = technique
    while isinstance(inner, techniques.Displayed):
        inner = inner.technique
    is_temporal = isinstance(inner, techniques.AbstractTemporal)
    yield "optional" if is_temporal else "yes" if period > 1 else "no"
    yield samples
    yield " ".join(sorted(technique.needs, key=list(CHANNELS).index))


def _costs(
    chosen: Sequence[AbstractTechnique], console: rich.console.Console
) -> Iterator[tuple[float, float]]:
    """Measure each on a picture, and its channels on solids."""
    picture, solids = scenes.study_set()["coffee"], fence()
    of_channels = functools.cache(lambda needs: cost.channels_ns(solids, needs))
    times = cost.techniques_ns(chosen, picture)
    with Display(console) as display:
        for done, technique in enumerate(chosen):
            doing = f"timing {technique.id}"
            display(Progress(done, len(chosen), doing, unit="techniques"))
            yield next(times), of_channels(technique.needs)


def _about(scene: StudyScene) -> tuple[str, str, str]:
    """Kind of a scene, how much is in it, and whether anything moves."""
    if not isinstance(scene, Solids):
        return "picture", "flat, infinitely far", "still"
    objects = counted(len(scene.classes) - 1, "object")
    primitives = counted(sum(len(table.object) for table in scene.tables), "primitive")
    return "solids", f"{objects}, {primitives}", "moves" if scene.moves else "still"


@dataclasses.dataclass(frozen=True)
class RenderCommand:
    """Write one picture of a scene, seen from where a head starts.

    Colour, or what else a scene gives techniques: depth and ids are shown in colours
    that are said; a file that ends in .npy has the numbers themselves.

    For example: hmdjit render fence --channel depth --out depth.png
    """

    scene: Annotated[
        tyro.conf.Positional[str],
        shown(
            "SCENE",
            "Name of a scene (see `hmdjit scenes`), a picture file, or your own, "
            "my_scene.py:scene.",
        ),
    ]
    channel: Annotated[str, shown("NAME", f"What is shown: {', '.join(CHANNELS)}")] = (
        "color"
    )
    technique: Annotated[
        str | None, shown("ID", "Colour as a technique shows its first frame.")
    ] = None
    width: Width = None
    height: Height = None
    fov: Fov = None
    out: Annotated[
        Path | None, shown("FILE", "A .png or .npy (default: SCENE.png).")
    ] = None

    def run(self, console: rich.console.Console) -> int:
        """Render, write, and say what is shown how."""
        _checks.one_of("channel", self.channel, CHANNELS)
        if self.technique is not None and self.channel != "color":
            raise ValueError("technique must go with the channel color alone.")
        ((name, scene),) = definition.named_scenes([self.scene]).items()
        out = self.out or Path(f"{name}.png")
        if out.suffix.lower() not in (".png", ".npy"):
            raise ValueError(f"out must end in .png or .npy, got {out}.")
        check_can_write(out.parent)
        sizes = {"width_px": self.width, "height_px": self.height, "fov_deg": self.fov}
        camera = Camera(**{k: v for k, v in sizes.items() if v is not None})
        technique = techniques.by_id(self.technique or "none")
        check_gives(scene.gives, name, technique)
        if self.channel not in scene.gives:
            raise ValueError(
                f"channel must be one that {name} gives, "
                f"{', '.join(sorted(scene.gives))}, got {self.channel}."
            )
        source = scene if isinstance(scene, AbstractSource) else bake(scene, camera)
        if self.technique is None:
            numbers = _channel(source, camera, channel=self.channel)
        else:
            numbers = _shown(source, camera, technique)
        planes = np.asarray(numbers)
        if out.suffix.lower() == ".npy":
            content = planes[0] if len(planes) == 1 else np.moveaxis(planes, 0, -1)
            words = "as numbers"
            with written_atomically(out) as unfinished, open(unfinished, "wb") as file:
                np.save(file, content)
        else:
            picture, words = _pictured(self.channel, planes)
            with written_atomically(out) as unfinished:
                _write_png(unfinished, picture)
        said = f"{self.channel}{f' by {technique.id}' if self.technique else ''}"
        console.out(
            f"Wrote {out}: {said} of {name}, {camera.width_px} x {camera.height_px} "
            f"px, {camera.fov_deg:g} deg; {words}."
        )
        return OK


def _at_rest() -> Motion:
    still = jnp.zeros(3, jnp.float32)
    return Motion(still, still)


@functools.partial(jax.jit, static_argnames=("channel",))
def _channel(
    source: AbstractSource, camera: Camera, *, channel: str
) -> Shaped[Array, "planes height width"]:
    """One channel at the pixels' centres."""
    names, region, still = {"color", channel}, Region.whole(camera), _at_rest()
    reading, centre = fastest_reading(), np.zeros((1, 2))
    frame = render(
        source, camera, region, still, centre, channels=names, reading=reading
    )
    if channel == "velocity" and channel not in frame.channels:  # nothing moves
        return jnp.zeros((2, camera.height_px, camera.width_px), jnp.float32)
    return (frame.color if channel == "color" else frame.channels[channel])[0]


@jax.jit
def _shown(source: AbstractSource, camera: Camera, technique: AbstractTechnique) -> Rgb:
    """Display the first frame of a technique."""
    if isinstance(source, Texture):
        technique = technique.on_pictures()
    renderer = Renderer(source, camera, fastest_reading())
    pattern = Pattern.of(technique, source.gives)
    frame = renderer.frame(pattern, Region.whole(camera), 0, _at_rest())
    return technique.step(technique.init(frame), frame, _at_rest())[1]


def _pictured(channel: str, planes: np.ndarray) -> tuple[Codes, str]:
    """Show a channel as colours, and say in words what they mean."""
    if channel in ("color", "albedo"):
        return codes(np.moveaxis(planes, 0, -1).astype(float)), "gamma"
    if channel == "depth":
        (depth,) = planes
        seen = np.isfinite(depth)
        if not seen.any():
            return codes(
                np.zeros((*depth.shape, 3))
            ), "black, for all is infinitely far"
        near, far = depth[seen].min(), depth[seen].max()
        nearness = np.where(seen, near / np.where(seen, depth, 1.0), 0.0)
        words = (
            f"white is the nearest, {near:.3g} m, half as light what is twice as far, "
            f"to {far:.3g} m; black is the background"
        )
        return codes(np.repeat(nearness[..., None], 3, axis=-1)), words
    if channel == "velocity":
        dx, dy = planes
        most = max(float(np.hypot(dx, dy).max()), 1e-9)
        parts = [0.5 + dx / (2 * most), 0.5 + dy / (2 * most), np.full(dx.shape, 0.5)]
        words = (
            f"grey is still, more red to the right, more green down, by {most:.3g} px"
        )
        return codes(np.stack(parts, axis=-1)), f"{words} per frame at most"
    (number,) = planes
    # Neighbouring numbers lie far apart on the circle of hues.
    hue = 2 * np.pi * ((number * 0.618034) % 1.0)
    thirds = 2 * np.pi / 3 * np.arange(3)
    rgb = 0.55 + 0.4 * np.cos(hue[..., None] - thirds)
    rgb = np.where((number == 0)[..., None], 0.0, rgb)
    what = "what is not covered" if channel == "coverage" else "the background"
    if channel == "motion_class":
        what = "what is static"
        others = [f"{i} {name}" for i, name in enumerate(MOTION_CLASSES)]
        return codes(rgb), f"black is {what}, a colour each for {', '.join(others[1:])}"
    return codes(rgb), f"black is {what}, each of 1 to {number.max()} has its colour"


def _write_png(path: Path, picture: Codes) -> None:
    import PIL.Image

    PIL.Image.fromarray(picture).save(path, format="PNG")
