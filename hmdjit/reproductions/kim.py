"""Head-movement based temporal anti-aliasing against multisampling (Kim et al.).

Kim et al. measured how much eleven pictures flicker in a headset whose wearer tries to
hold still: without anti-aliasing, with MSAA, and with their technique. Here the same is
simulated on eleven pictures of ours, heads that fixate, and on solids, where MSAA has
edges to smooth. What of their figure depends on the head is drawn as a map.
"""

import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import scenes as known
from ..camera import Camera, Region
from ..estimates.estimate import mean_of
from ..estimates.intervals import (
    Interval,
    student_interval,
)
from ..frames.motion import Motion
from ..head_motion import HeadMotion
from ..metrics import MTCD
from ..rendering import render
from ..scenes.baking import bake
from ..simulation.apply import apply
from ..studies.progress import Progress, Tell
from ..studies.study import Study
from ..techniques import MSAA, HeadMovement, NoAntialiasing
from . import kim_map
from .claims import Found
from .kim_claims import (
    NAMES,
    TIMED,
    TIMED_PX,
    claim_on_cost,
    claims_on_pictures,
    claims_on_solids,
    figure_3,
    means,
)
from .timing import times

TITLE = "Head-movement based temporal anti-aliasing (Kim et al.)"
CAMERA = Camera()
SESSIONS, QUICK_SESSIONS = 1000, 100

_SOLIDS = ("pipe", "blinds", "arched_window", "atrium", "wall_text")
_QUICK_SOLIDS = ("pipe", "blinds")
_PER_SOLID_SESSION = 5  # sessions on pictures for one on solids, which take longer
_SHOWN, _SHOWN_PX, _SHOWN_FRAMES = "text", 192, 14  # in figure 4, of which the last two
NOT_SIMULATED = (
    "Not simulated: 2 ms a frame, which were of their GPU (here it is a share of a "
    "frame), and their eleven pictures and heads, which are not public: absolute MTCD, "
    "largest and least, are those of others. Figure 4 is drawn, and no claim."
)


def studies(camera: Camera, sessions: int) -> dict[str, Study]:
    """Return the experiment on pictures, and on solids."""
    is_quick = sessions <= QUICK_SESSIONS
    several = MSAA(4), HeadMovement(), NoAntialiasing()
    solids = known.solid_set()
    common = {"camera": camera, "head": HeadMotion.fixating(), "metrics": (MTCD(),)}
    return {
        "pictures": Study(
            scenes=known.study_set(), techniques=several, sessions=sessions, **common
        ),
        "solids": Study(
            scenes={n: solids[n] for n in (_QUICK_SOLIDS if is_quick else _SOLIDS)},
            techniques=(*several, HeadMovement(resolve=MSAA(4))),
            sessions=max(2, sessions // _PER_SOLID_SESSION),
            **common,
        ),
    }


def run(
    camera: Camera,
    sessions: int,
    *,
    seed: int = 0,
    out: str | os.PathLike,
    overwrite: bool = False,
    progress: Tell = lambda event: None,
) -> Found:
    """Run the experiment, or go on with it.

    **Arguments:** `out`: folder where finished batches are kept; `overwrite`: whether
    results of another experiment in it are replaced.
    """
    made, values = studies(camera, sessions), {}
    for name, each in made.items():
        dataset = each.run(
            seed, out=Path(out) / name, overwrite=overwrite, progress=progress
        )
        ids = [technique.id for technique in each.techniques]
        values[name] = dict(zip(ids, dataset["mtcd"].values, strict=True))
    places = _map(camera, sessions, seed, out, progress)
    progress(Progress(doing="timing a frame"))
    share = cost_share()
    pictures, names = values["pictures"], list(made["pictures"].scenes)
    return Found(
        title=TITLE,
        about=_about(made),
        claims=[
            *claims_on_pictures(pictures, names, places),
            *claims_on_solids(values["solids"]),
            claim_on_cost(share),
        ],
        measured=[*figure_3(pictures), *means("MTCD, solids", values["solids"])],
        cases=("max", "mean", "min"),
        lines=[NOT_SIMULATED],
        tables={"map": places},
        pictures=two_frames(camera, seed),
    )


def _map(
    camera: Camera, sessions: int, seed: int, out: str | os.PathLike, progress: Tell
) -> list[kim_map.Place]:
    pictures = known.study_set()
    how: Any = {"out": out, "progress": progress}
    if sessions > QUICK_SESSIONS:
        several = {name: pictures[name] for name in ("coffee", "noise")}
        return kim_map.ratios(several, camera, 64, seed, **how)
    coarse = {
        "correlations": (0.0, 0.5, 0.95),
        "px_per_frame": (0.1, 0.3, 1.0),
        "refresh_hz": (60.0,),
    }
    few = {"coffee": pictures["coffee"]}
    return kim_map.ratios(few, camera, 32, seed, **coarse, **how)


def cost_share(repeats: int = 7) -> Interval:
    """Time that head movement adds to a frame, over that of rendering one.

    It is told on a picture, beside whose rendering it is not lost in the noise.
    """
    camera = Camera(TIMED_PX, TIMED_PX, 60.0, 60.0)
    picture = bake(known.study_set()[_SHOWN], camera)
    both = NoAntialiasing(), HeadMovement()
    plain, blended = times(picture, camera, both, repeats).T
    (rendered,) = times(known.solid_set()[TIMED], camera, both[:1], repeats).T
    return student_interval(mean_of((blended - plain) / rendered))


def two_frames(camera: Camera, seed: int) -> dict[str, Float[np.ndarray, "2 h w 3"]]:
    """Return figure 4: two consecutive frames of the same session, by condition."""
    head, region = HeadMotion.fixating(), Region.whole(camera)
    poses = head.sample(jax.random.key(seed), camera.refresh_hz, _SHOWN_FRAMES)
    texture, centre = bake(known.study_set()[_SHOWN], camera), np.zeros((1, 2))

    @jax.jit
    def seen(now: Motion) -> Float[Array, "h w 3"]:
        color = render(texture, camera, region, now, centre).color[0]
        return jnp.moveaxis(color, 0, -1)

    frames = jax.lax.map(seen, Motion.of(poses))
    sides = camera.width_px, camera.height_px
    left, top = (max(0, s - _SHOWN_PX) // 2 for s in sides)
    part = (slice(-2, None), slice(top, top + _SHOWN_PX), slice(left, left + _SHOWN_PX))
    return {
        NAMES[technique.id]: np.asarray(
            apply(technique.on_pictures(), camera, frames, poses)[part]
        )
        for technique in (MSAA(4), HeadMovement())
    }


def _about(made: dict[str, Study]) -> str:
    pictures, solids = made["pictures"], made["solids"]
    camera = pictures.camera
    correlation, px = kim_map.motion_of(
        HeadMotion.fixating(), camera, camera.refresh_hz
    )
    return (
        f"{pictures.sessions} sessions on {len(pictures.scenes)} pictures, "
        f"{solids.sessions} on solids ({', '.join(solids.scenes)}), people who fixate "
        f"({px:.2f} px RMS per frame and axis in the middle, a frame's turn correlated "
        f"with the next by {correlation:.2f}), {camera.refresh_hz:g} Hz, "
        f"{pictures.measure}, {pictures.frames} frames after {pictures.warmup}. The "
        "pictures stand for the paper's, which are not public. Intervals (95 %) are "
        "over sessions, paired; pictures are fixed."
    )
