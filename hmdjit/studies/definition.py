"""What a study is: scenes, techniques, a head, a display, metrics, and how much."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx

from .. import _checks
from ..camera import Camera
from ..estimates.summary import GEOMETRIC_MEAN, POOLED
from ..frames.neck import NeckModel
from ..frames.sources import AbstractSource
from ..frames.texture import Texture
from ..head_motion import HeadMotion
from ..metrics import STANDARD, AbstractMetric
from ..metrics.base import check_block, check_metrics
from ..scenes.baking import check_baking
from ..scenes.base import AbstractScene, check_scene
from ..simulation.simulate import check_gives
from ..technique_contract.base import AbstractTechnique
from ..technique_contract.shapes import check_declared
from .measured_blocks import Measurement, Tiles
from .sessions import Head


def check_seed(seed: int) -> None:
    """Raise unless a seed is one that does not wrap around."""
    _checks.whole("seed", seed, 0)
    _checks.in_range("seed", seed, 0, 2**32 - 1)


StudyScene = AbstractScene | AbstractSource
"""A source, as solids are one, is seen as it is; all else are pictures, and baked."""


class Shapes(NamedTuple):
    """Least sizes of what is compiled, by which studies of a sweep share programs.

    What is wider than it must be moves no number by more than a halo's tolerance.

    - `margin_px`: of textures around the camera frame, display px.
    - `halo_px`, `solid_halo_px`: around measured blocks of pictures and of solids.
    """

    margin_px: int = 0
    halo_px: int = 0
    solid_halo_px: int = 0


class StudyDefinition(eqx.Module):
    """The fields of a `Study`, checked."""

    scenes: Mapping[str, StudyScene]
    techniques: tuple[AbstractTechnique, ...] = eqx.field(converter=tuple)
    head: Head
    camera: Camera = eqx.field(default_factory=Camera)
    sessions: int = 500
    frames: int = 10
    warmup: int = 12
    measure: Measurement = eqx.field(default=None)  # two tiles of the largest size
    baseline: str = "msaa4"
    oversampling: int = 2
    margin_deg: float = 6.0
    metrics: tuple[AbstractMetric, ...] = eqx.field(converter=tuple, default=STANDARD)
    neck: NeckModel | None = NeckModel()
    reference_samples: int = 16
    reference_every: int = 3  # of ten frames as sure as all, for half the time
    shapes: Shapes = Shapes()

    def __post_init__(self):
        if self.measure is None:
            self.measure = Tiles.fitting(self.camera)

    def __check_init__(self):
        if not self.scenes:
            raise ValueError("scenes must name at least one scene, got none.")
        if not self.techniques:
            raise ValueError("techniques must name at least one technique, got none.")
        for technique in self.techniques:
            check_declared(technique)
        if not isinstance(self.head, Head):
            raise ValueError(f"head must be a HeadMotion or Replay, got {self.head!r}.")
        ids = [technique.id for technique in self.techniques]
        if len(set(ids)) < len(ids):
            raise ValueError(
                f"techniques must have distinct ids, got {', '.join(ids)}."
            )
        _checks.one_of("baseline", self.baseline, ids)
        check_metrics(self.metrics)
        if self.metrics[0].is_in_decibels:
            raise ValueError(
                "metrics must begin with one that has ratios, and decibels have none: "
                f"name mse before {self.metrics[0].id}."
            )
        if isinstance(self.measure, Tiles):
            for metric in self.metrics:
                if not metric.is_of_tiles:
                    raise ValueError(
                        f"metrics must not have {metric.id} on tiles, of which it is "
                        "no mean: measure a crop or the whole frame, or name psnr."
                    )
        _checks.whole("sessions", self.sessions, 1)
        _checks.whole("frames", self.frames, 2)
        _checks.whole("warmup", self.warmup, 0)
        check_block(self.metrics, *self.measure.block_size(self.camera))
        check_baking(self.camera, self.oversampling, self.margin_deg)
        if not isinstance(self.neck, NeckModel | None):
            raise ValueError(f"neck must be a NeckModel or None, got {self.neck!r}.")
        _checks.whole("reference_samples", self.reference_samples, 1)
        _checks.whole("reference_every", self.reference_every, 1)
        for name, scene in self.scenes.items():
            if name in (POOLED, GEOMETRIC_MEAN):
                raise ValueError(f"scenes must not be named {name!r}: a pooled row is.")
            if isinstance(scene, Texture):
                raise ValueError(f"scene {name!r} must not be baked: studies do it.")
            if not isinstance(scene, AbstractSource):
                check_scene(scene, self.camera, name)
            for technique in self.techniques:
                check_gives(scene.gives, name, technique)

    @property
    def display(self) -> Camera:
        """The camera, at the rate that heads are replayed at."""
        if isinstance(self.head, HeadMotion):
            return self.camera
        return eqx.tree_at(lambda c: c.refresh_hz, self.camera, self.head.refresh_hz)
