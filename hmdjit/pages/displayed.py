"""What is displayed in one session of a study, and what its head does, as arrays."""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import signal

from .. import camera as pinhole
from ..camera import Camera, Region
from ..color import CODE_VALUES
from ..frames.motion import Motion
from ..frames.sources import AbstractSource
from ..metrics import MTCD
from ..reproductions.played import play
from ..simulation.simulate import check_gives
from ..studies.definition import StudyDefinition
from ..studies.stage import drawing, source_of
from ..studies.store import fingerprint
from ..technique_contract.base import AbstractTechnique

SIDE_PX, _HALO_PX = 128, 24
FRAMES = 60
"""Measured frames of the session: enough for a spectrum."""
_SESSIONS = 256  # of which the one of median turns is shown

Clip = Float[np.ndarray, "frames height width 3"]
Clips = Mapping[str, Clip]


@dataclasses.dataclass(frozen=True)
class Displayed:
    """A session's frames in the centre of the camera frame, by technique.

    - `motion`: of all sessions that it was chosen from, warm-up included.
    - `px_per_deg`: how far the picture moves in the centre when a head turns.
    """

    scene: str
    session: int
    clips: Clips
    motion: Motion
    rate_hz: float
    px_per_deg: float


def displayed(
    study: StudyDefinition,
    seed: int,
    scene: str,
    techniques: list[str],
    sessions: int,
) -> Displayed:
    """Simulate one session of a study: of its first 256, the one of median turns.

    It is drawn as the study's are, but is longer.

    **Arguments:** `techniques`: ids of those that are shown; `sessions`: how many the
    study has.

    **Errors:** `ValueError` where recorded heads have no window, or one that leaves
    what a scene covers.
    """
    camera, chosen = study.display, study.scenes[scene]
    is_solid = isinstance(chosen, AbstractSource)
    longer = dataclasses.replace(study, frames=max(FRAMES, study.frames))
    count = min(_SESSIONS, sessions)
    try:
        drawn = drawing(longer, seed, is_solid=is_solid)(count)
    except ValueError:  # no recording is as long
        longer = study
        drawn = drawing(longer, seed, is_solid=is_solid)(count)
    motion = drawn.batch(0, count).motion
    turns = np.mean(np.sum(np.square(motion.increment), axis=-1), axis=-1)
    session = int(np.argsort(turns)[len(turns) // 2])
    kinds = {t.id: t if is_solid else t.on_pictures() for t in study.techniques}
    # On pictures several are one; two classes of one's own may differ in nothing else.
    keys = {id: fingerprint(kinds[id], kinds[id].id) for id in techniques}
    first = {key: id for id, key in reversed(keys.items())}
    several = tuple(kinds[id] for id in first.values())
    for technique in several:
        check_gives(chosen.gives, scene, technique)
    sides = [
        min(SIDE_PX + 2 * _HALO_PX, s) for s in (camera.width_px, camera.height_px)
    ]
    place = [(s - p) // 2 for s, p in zip(_size(camera), sides, strict=True)]
    region = Region(*place, *sides)
    mine = jax.tree.map(lambda leaf: jnp.asarray(leaf[session]), motion)
    source = source_of(study, chosen)
    if not bool(source.covers(camera, region, mine)):
        raise ValueError(f"{scene} must cover what the head sees: it left the margin.")
    frames = _frames(source, camera, several, mine, region, longer.warmup)
    edges = [max(0, (p - SIDE_PX) // 2) for p in sides]
    x, y = (slice(e, p - e) for e, p in zip(edges, sides, strict=True))
    clips = np.clip(np.moveaxis(np.asarray(frames), 2, -1)[:, :, y, x], 0, 1)
    of_keys = dict(zip(first, clips, strict=True))
    centre = jnp.asarray(_size(camera), jnp.float32) / 2
    return Displayed(
        scene,
        session,
        {id: of_keys[keys[id]] for id in techniques},
        motion,
        float(camera.refresh_hz),
        float(pinhole.px_per_deg(camera, centre)[0]),
    )


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width_px, camera.height_px


def _frames(
    source: AbstractSource,
    camera: Camera,
    techniques: tuple[AbstractTechnique, ...],
    motion: Motion,
    region: Region,
    warmup: int,
) -> Float[Array, "techniques frames 3 height width"]:
    shown = lambda carry, moment: (carry, moment.shown)

    @jax.jit
    def run(
        source: AbstractSource, techniques: tuple[AbstractTechnique, ...]
    ) -> Float[Array, "frames techniques 3 height width"]:
        start = jnp.int32(0)
        return play(source, camera, techniques, motion, start, shown, region=region)

    return jnp.moveaxis(run(source, techniques)[warmup:], 1, 0)


def flicker_map(clip: Clip) -> Float[np.ndarray, "height width"]:
    """MTCD of each pixel, code values."""
    planes = jnp.moveaxis(jnp.asarray(clip), -1, 1)
    each = jax.vmap(lambda now, before: MTCD().per_pixel(now, before, None))
    return np.asarray(jnp.mean(each(planes[1:], planes[:-1]), axis=0))


def spectrum(
    values: Float[np.ndarray, "frames ..."], rate_hz: float
) -> tuple[Float[np.ndarray, " freqs"], Float[np.ndarray, "freqs ..."]]:
    """One-sided periodogram over frames, less the mean, by Hann's window.

    **Returns:** frequencies above 0, Hz, and the density per Hz.
    """
    hz, density = signal.periodogram(
        values, rate_hz, window="hann", detrend="constant", axis=0
    )
    return hz[1:], density[1:]


def temporal_spectrum(
    clip: Clip, rate_hz: float
) -> tuple[Float[np.ndarray, " freqs"], Float[np.ndarray, " freqs"]]:
    """Spectrum of what a pixel shows: of its three colours together, pixels' mean.

    **Returns:** frequencies, Hz, and code values squared per Hz.
    """
    hz, density = spectrum(CODE_VALUES * clip, rate_hz)
    return hz, density.sum(axis=-1).mean(axis=(1, 2))


def change_by_octave(
    clip: Clip, px_per_deg: float
) -> tuple[Float[np.ndarray, " edges"], Float[np.ndarray, " octaves"]]:
    """RMS colour change from frame to frame in octaves of spatial frequency.

    **Returns:** edges of the octaves, cycles per degree, the finest being that of two
    pixels and beyond, and code values.
    """
    change = CODE_VALUES * np.diff(clip, axis=0)
    sides = change.shape[1:3]
    window = np.outer(*(np.hanning(side + 1)[:-1] for side in sides))
    window = window / np.sqrt(np.mean(window**2))
    parts = np.fft.fft2(change * window[..., None], axes=(1, 2)) / np.prod(sides)
    power = (np.abs(parts) ** 2).sum(axis=-1).mean(axis=0)
    y, x = (np.fft.fftfreq(side) for side in sides)
    per_px = np.hypot(y[:, None], x)
    octaves = max(2, int(np.log2(min(sides))) - 2)
    edges = 0.5 / 2.0 ** np.arange(octaves, -1, -1)
    edges[0] = 0.0
    place = np.clip(np.searchsorted(edges, per_px, "right") - 1, 0, octaves - 1)
    return edges * px_per_deg, np.sqrt(
        np.bincount(place.ravel(), power.ravel(), octaves)
    )
