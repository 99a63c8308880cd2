"""A study's scenes, each with what runs sessions of it.

Pictures are baked and have no depth: the head's positions do not exist for them, and
techniques that show the same on them are one. Solids are seen as they are, by an eye
that a neck moves, and each technique is its own.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from ..frames.sources import AbstractSource
from ..scenes.baking import bake
from ..simulation.session import fastest_reading
from ..simulation.sharding import placed
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.check import check_hints
from .definition import StudyDefinition, StudyScene
from .measured_blocks import Measurement
from .runner import Runner
from .sessions import Sessions
from .store import fingerprint

_PILOT_SESSIONS = 256

Techniques = dict[str, AbstractTechnique]
Places = dict[str, list[int]]


@dataclasses.dataclass(frozen=True)
class Stage:
    """A scene of a study.

    - `key`: of what decides its numbers, beside what all scenes share.
    - `techniques`: those that are distinct, by key; `places`: theirs in the study.
    - `runner`: measures sessions of it, which `sessions` draws, a number of them.
    - `source`: makes what is rendered, on all devices.
    """

    name: str
    scene: StudyScene
    key: str
    techniques: Techniques
    places: Places
    runner: Runner
    sessions: Callable[..., Sessions]
    source: Callable[[], AbstractSource]

    @property
    def is_solid(self) -> bool:
        """Whether it is seen as it is, and not baked."""
        return isinstance(self.scene, AbstractSource)


class Task(NamedTuple):
    """A batch: scene, first session, how many, and techniques by fingerprint."""

    stage: int
    start: int
    size: int
    techniques: tuple[str, ...]


def missing(
    stages: Sequence[Stage],
    ran: Bool[np.ndarray, "technique scene session"],
    batch_size: int,
) -> Iterator[Task]:
    """Name the batches that were not run yet, scene by scene."""
    for s, stage in enumerate(stages):
        keys = np.array(list(stage.techniques))
        lacks = ~ran[[places[0] for places in stage.places.values()], s]
        starts = np.flatnonzero((lacks[:, 1:] != lacks[:, :-1]).any(axis=0)) + 1
        for first, stop in itertools.pairwise([0, *starts.tolist(), lacks.shape[1]]):
            chosen = lacks[:, first]
            for start in range(first, stop, batch_size) if chosen.any() else ():
                size = min(batch_size, stop - start)
                yield Task(s, start, size, tuple(keys[chosen].tolist()))


def drawing(
    study: StudyDefinition, seed: int, *, is_solid: bool = False
) -> Callable[..., Sessions]:
    """Return what draws so many sessions of a study, by default of its blocks."""
    length = study.warmup + study.frames

    def sessions(count: int, measure: Measurement | None = None) -> Sessions:
        return Sessions(
            seed,
            study.head,
            study.display,
            study.measure if measure is None else measure,
            count,
            length,
            neck=study.neck if is_solid else None,
            has_places=is_solid,
        )

    return sessions


def stages(study: StudyDefinition, seed: int, batch_size: int) -> list[Stage]:
    """Set the scenes of a study up."""
    for technique in study.techniques:
        check_hints(technique)
    usual = fastest_reading()
    accurate = dataclasses.replace(
        usual,
        reference_samples=study.reference_samples,
        reference_every=study.reference_every,
    )
    known: dict[str, Runner] = {}

    def runner(scene: StudyScene, techniques: Techniques) -> Runner:
        """Share a runner among scenes whose halos are alike."""
        solid = isinstance(scene, AbstractSource)
        follows = any("velocity" in t.needs for t in techniques.values())
        moving = scene if follows and isinstance(scene, AbstractSource) else None
        kind = str(solid) if moving is None else fingerprint(scene)
        if kind not in known:
            # The pilot's sessions are always the same ones, so that no session's result
            # depends on which others are run with it.
            pilot = drawing(study, 0, is_solid=solid)(_PILOT_SESSIONS)
            known[kind] = Runner(
                study.display,
                study.measure,
                list(techniques.values()),
                study.warmup,
                batch_size,
                pilot.batch(0, pilot.count),
                accurate if solid else usual,
                study.metrics,
                moving=moving,
                least_halo_px=study.shapes[1 + solid],
            )
        return known[kind]

    def stage(name: str, scene: StudyScene) -> Stage:
        solid, techniques, places = isinstance(scene, AbstractSource), {}, {}
        for place, technique in enumerate(study.techniques):
            technique = technique if solid else technique.on_pictures()
            # Two classes of one's own may differ in nothing else.
            key = fingerprint(technique, technique.id)
            techniques.setdefault(key, technique)
            places.setdefault(key, []).append(place)
        own = study.neck, study.reference_samples, study.reference_every
        return Stage(
            name,
            scene,
            fingerprint(scene, *own) if solid else fingerprint(scene),
            techniques,
            places,
            runner(scene, techniques),
            drawing(study, seed, is_solid=solid),
            lambda: placed(source_of(study, scene)),
        )

    return [stage(name, scene) for name, scene in study.scenes.items()]


def source_of(study: StudyDefinition, scene: StudyScene) -> AbstractSource:
    """Make what is rendered of a scene."""
    if isinstance(scene, AbstractSource):
        return scene
    return bake(
        scene,
        study.display,
        oversampling=study.oversampling,
        margin_deg=study.margin_deg,
        least_margin_px=study.shapes.margin_px,
    )
