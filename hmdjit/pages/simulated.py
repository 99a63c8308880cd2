"""Sections of a study's page that rest on one session, simulated anew."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ..figures import displayed as figures
from ..figures import kim
from ..figures.techniques import Compared
from ..head_motion.parameters import AXES
from ..reports.tables import READY, WORDS, Continued, table
from ..studies.definition import StudyDefinition
from . import markup
from .displayed import (
    Displayed,
    change_by_octave,
    displayed,
    flicker_map,
    spectrum,
    temporal_spectrum,
)

Keep = Callable[[str, Figure], bytes]
"""Keeps a figure by its name, and returns its PNG."""

_MOST = 10  # techniques that are simulated
_ROWS = 24  # of a table of a spectrum


def sections(
    study: StudyDefinition,
    seed: int,
    scene: str,
    compared: Compared,
    pair: tuple[str, str],
    keep: Keep,
) -> dict[str, list[str]]:
    """Simulate a session and return its sections by their headings.

    **Arguments:** `pair`: the techniques that the viewer shows first.

    **Errors:** those of `displayed`.
    """
    ids = list(dict.fromkeys([*pair, *compared.techniques]))[:_MOST]
    ids = [id for id in compared.techniques if id in ids]
    shown = displayed(study, seed, scene, ids, compared.mtcd.shape[-1])
    some = next(iter(shown.clips.values()))
    footer = (
        f"Session {shown.session} of {len(shown.motion.offset)}, the one of median "
        f"turns, {len(some)} frames at {shown.rate_hz:.4g} Hz; {scene}, the central "
        f"{some.shape[2]} x {some.shape[1]} px. {compared.footer}"
    )
    left_out = len(compared.techniques) - len(ids)
    about = (
        f"One session on {scene}, the scene of this page: of the first "
        f"{len(shown.motion.offset)} that the study draws, at this length, the one "
        f"whose head turns by the median. Shown are the central {some.shape[2]} x "
        f"{some.shape[1]} px."
    )
    if left_out:
        about += f" {left_out} techniques beyond {_MOST} are left out."
    maps = {name: flicker_map(clip) for name, clip in shown.clips.items()}
    first = {name: clip[0] for name, clip in shown.clips.items()}
    pictures = {
        "Where it flickers": flicker_maps(first, maps, footer, keep),
        "Two frames and their difference": _differences(shown, pair, footer, keep),
        "How fast and how fine": _spectra(shown, compared, footer, keep),
        "Heads": _head(shown, footer, keep),
    }
    viewer = markup.viewer(shown.clips, shown.rate_hz, pair)
    found = {"Flicker viewer": [markup.paragraph(about), viewer]}
    return found | {name: [markup.figure(one)] for name, one in pictures.items()}


def flicker_maps(
    pictures: Mapping[str, np.ndarray],
    maps: Mapping[str, np.ndarray],
    footer: str,
    keep: Keep,
) -> markup.Picture:
    """Return maps of MTCD, below a picture of each, as a figure of a page."""
    means = "; ".join(f"{name} {one.mean():.3g}" for name, one in maps.items())
    rows = [
        [name, *(f"{q:.3g}" for q in (one.mean(), *np.quantile(one, (0.5, 0.95, 1))))]
        for name, one in maps.items()
    ]
    return markup.Picture(
        keep("flicker_map", figures.flicker_maps(pictures, maps, footer)),
        "Above, a displayed frame of each; below, its map of each pixel's MTCD, bright "
        f"where it flickers. Means: {means}.",
        "MTCD of each pixel, code values of 8 bits",
        numbers(["clip", "mean", "median", "95 %", "largest pixel"], rows),
        is_chart=False,
    )


def _differences(
    shown: Displayed, pair: tuple[str, str], footer: str, keep: Keep
) -> markup.Picture:
    middle = len(next(iter(shown.clips.values()))) // 2
    two = {name: shown.clips[name][middle : middle + 2] for name in dict.fromkeys(pair)}
    means = [[name, f"{flicker_map(clip).mean():.3g}"] for name, clip in two.items()]
    words = "; ".join(f"{name}: MTCD {value}" for name, value in means)
    return markup.Picture(
        keep("differences", kim.two_frames(two, footer)),
        "A displayed frame, the next one, and their difference, magnified below, by "
        f"each technique. {words}.",
        "Two consecutive frames and their difference, as Kim et al., Figure 4",
        numbers(["technique", "MTCD of the two"], means),
        is_chart=False,
    )


def _spectra(
    shown: Displayed, compared: Compared, footer: str, keep: Keep
) -> markup.Picture:
    clips = shown.clips.items()
    temporal = {name: temporal_spectrum(clip, shown.rate_hz) for name, clip in clips}
    octaves = {name: change_by_octave(clip, shown.px_per_deg) for name, clip in clips}
    hz, _ = next(iter(temporal.values()))
    edges, _ = next(iter(octaves.values()))
    bands = figures.band_names(edges)
    every = some(len(hz))
    lines = [f"{hz[k]:.3g} Hz, code values²/Hz" for k in every]
    lines += [f"{band} cycles per degree, code values" for band in bands]
    columns = [
        [*density[every], *octaves[name][1]] for name, (_, density) in temporal.items()
    ]
    rows = [
        [line, *(f"{value:.3g}" for value in values)]
        for line, *values in zip(lines, *columns, strict=True)
    ]
    finest = {name: change[-1] for name, (_, change) in octaves.items()}
    words = "; ".join(f"{name} {value:.3g}" for name, value in finest.items())
    return markup.Picture(
        keep("spectra", figures.spectra(temporal, octaves, compared.style, footer)),
        "Left, the temporal spectrum of a pixel by technique; right, the change from "
        f"frame to frame by spatial frequency. RMS change {bands[-1]} cycles per "
        f"degree: {words}.",
        f"What is displayed, over temporal and spatial frequency "
        f"({shown.px_per_deg:.3g} px per degree)",
        numbers(["frequency", *shown.clips], rows),
    )


def _head(shown: Displayed, footer: str, keep: Keep) -> markup.Picture:
    # The first pose has no turn before it.
    turns_deg = np.degrees(np.asarray(shown.motion.increment))[:, 1:]
    velocity = np.moveaxis(turns_deg * shown.rate_hz, 1, 0)
    hz, density = spectrum(velocity, shown.rate_hz)
    density = density.mean(axis=1)
    px = shown.px_per_deg * np.linalg.norm(turns_deg[..., :2], axis=-1)  # not of roll
    offset_deg = np.degrees(np.linalg.norm(np.asarray(shown.motion.offset), axis=-1))
    seconds = np.arange(offset_deg.shape[1]) / shown.rate_hz
    bounds = np.quantile(offset_deg, (0.05, 0.5, 0.95), axis=0).T
    wander = (seconds, bounds)
    middle, fast = np.quantile(px, (0.5, 0.95))
    shares = (0.05, 0.25, 0.5, 0.75, 0.95)
    rows = [
        [
            f"velocity spectrum, (deg/s)²/Hz, {axis}, {hz[k]:.3g} Hz",
            f"{density[k, a]:.3g}",
        ]
        for a, axis in enumerate(AXES)
        for k in some(len(hz), 8)
    ]
    rows += [
        [f"px per frame, {100 * share:g} % of frames", f"{np.quantile(px, share):.3g}"]
        for share in shares
    ]
    rows += [
        [
            f"wander after {seconds[k]:.2g} s, 5, 50 and 95 % of sessions, deg",
            ", ".join(f"{bound:.3g}" for bound in bounds[k]),
        ]
        for k in some(len(seconds), 6)
    ]
    return markup.Picture(
        keep("head", figures.head((hz, density), px.ravel(), wander, footer)),
        f"Left, the spectrum of head velocity per axis; middle, how far the picture "
        f"moves: median {middle:.3g} px per frame, 95 % at most {fast:.3g}; right, how "
        f"far heads wander: {bounds[-1, 1]:.3g} deg after {seconds[-1]:.2g} s in the "
        "median session.",
        f"What heads do, in {len(offset_deg)} sessions",
        numbers(["what", "value"], rows),
    )


def some(count: int, most: int = _ROWS) -> list[int]:
    """Choose places of at most so many rows, dense where they begin."""
    if count <= most:
        return list(range(count))
    places = np.geomspace(1, count, most).round().astype(int) - 1
    return sorted(set(places.tolist()))


def numbers(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Continued:
    """Lay out a figure's numbers."""
    first, *others = columns
    return table({first: WORDS} | dict.fromkeys(others, READY), rows)
