"""Settings of fidelity: what there is to choose between speed and accuracy.

The knobs are in `knobs`: one is turned at a time from the study's own setting.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._types import Rgb
from ..camera import Camera
from ..frames.displacement import Reading
from ..frames.frame import Frame
from ..frames.sources import AbstractSource
from ..simulation.session import fastest_reading
from ..studies.measured_blocks import CentralCrop, Measurement, Tiles
from ..studies.study import Study
from ..technique_contract.base import AbstractSpatial, AbstractTechnique
from ..techniques import SSAA

REFERENCE = "reference"
DEFAULT = "default"
"""Knob of the rows in which no knob is turned."""


_OPTIONS = ("reference_samples", "reference_every")  # of a reading, of a study too


@dataclasses.dataclass(frozen=True)
class Setting:
    """One way to measure, with everything that trades accuracy for speed.

    - `name`, `knob`: what tables call it, and which knob is turned in it.
    - `measure`: which blocks of the camera frame.
    - `oversampling`: texels per display pixel and axis, 1, 2 or 4.
    - `dtype`: `"float32"`, `"float64"`, or `"bfloat16"`: texels only, then float32.
    - `reading`: how sources are read.
    - `shrink`: the camera has so many times fewer pixels per axis; same field of view.
    - `is_other_device`: the modelled device differs: no approximation of the reference.
    - `kind`: `"picture"`, which is baked; solids, by `"rays"` or `"baked"` as well.
    """

    name: str
    knob: str
    measure: Measurement
    oversampling: int = 2
    dtype: str = "float32"
    reading: Reading = dataclasses.field(default_factory=fastest_reading)
    shrink: int = 1
    is_other_device: bool = False
    kind: str = "picture"

    @property
    def is_baked(self) -> bool:
        """Whether a texture is read; else rays are cast."""
        return self.kind != "rays"

    def camera(self, full: Camera) -> Camera:
        """Return the camera with the setting's number of pixels.

        **Errors:** `ValueError` if its size is not a multiple of the factor, or the
        measured blocks do not fit it.
        """
        k = self.shrink
        if full.width_px % k or full.height_px % k:
            raise ValueError(f"width and height must be multiples of {k} px.")
        camera = Camera(
            full.width_px // k, full.height_px // k, full.fov_deg, full.refresh_hz
        )
        self.measure.block_size(camera)
        return camera

    def samples_frame(self) -> bool:
        """Whether its mean is that of the camera frame's own pixels."""
        return self.shrink == 1 and not isinstance(self.measure, CentralCrop)

    def fidelity(self) -> tuple:
        """Return what decides the pixels, apart from which are measured."""
        return (*self.texture(), self.reading)

    def texture(self) -> tuple:
        """Return what decides the texture; measured in this order, it is baked once."""
        return self.shrink, self.kind, self.oversampling, self.dtype

    def study_options(self, full: Camera) -> str:
        """Options of `hmdjit study` that set what it lets one set."""
        camera, measure = self.camera(full), self.measure
        if isinstance(measure, Tiles):
            blocks = f"--tiles {measure.count} --tile-size {measure.size_px}"
        elif isinstance(measure, CentralCrop):
            blocks = f"--crop {measure.size_px}"
        else:
            blocks = "--whole-frame"
        size = f"--width {camera.width_px} --height {camera.height_px}"
        usual, words = Reading(), ""
        for name in _OPTIONS:
            if (value := getattr(self.reading, name)) != getattr(usual, name):
                words += f" --{name.replace('_', '-')} {value}"
        if not self.is_baked:
            return f"{size} {blocks}{words}"
        words += " --baked --no-neck" * (self.kind == "baked")
        return f"{size} {blocks} --oversampling {self.oversampling}{words}"

    def python_fields(self) -> str:
        """Return what only Python can set, as Python; empty if there is nothing."""
        usual = fastest_reading()
        said = [
            f'{field.name}="{getattr(self.reading, field.name)}"'
            for field in dataclasses.fields(Reading)
            if getattr(self.reading, field.name) != getattr(usual, field.name)
            and field.name not in _OPTIONS
        ]
        words = [f"Reading({', '.join(said)})"] if said else []
        if self.dtype != "float32":
            words.append(f"bake(dtype=jnp.{self.dtype})")
        return ", ".join(words)


class EverySample(AbstractSpatial):
    """SSAA by one lookup per sample, also where a texture carries the mean ready made.

    - `factor`: samples per axis.
    """

    factor: int = eqx.field(static=True, default=4)

    @property
    def id(self) -> str:
        """`ssaa4-by-samples`, with the factor."""
        return f"ssaa{self.factor}-by-samples"

    @property
    def sample_offsets_px(self) -> Float[np.ndarray, "period samples 2"]:
        """Return an ordered grid."""
        return SSAA(self.factor).sample_offsets_px

    def resolve(self, frame: Frame) -> Rgb:
        """Mean of the samples."""
        return SSAA(self.factor).resolve(frame)


@dataclasses.dataclass(frozen=True)
class Case:
    """A setting and a technique to measure in it.

    - `compared`: the technique whose reference it is held against.
    """

    setting: Setting
    technique: AbstractTechnique
    compared: AbstractTechnique


def is_solid(study: Study) -> bool:
    """Whether a study's one scene is seen as it is, and not baked."""
    return any(isinstance(scene, AbstractSource) for scene in study.scenes.values())


def default_setting(study: Study) -> Setting:
    """Return the setting of a study as it is."""
    usual = Setting(DEFAULT, DEFAULT, study.measure, study.oversampling)
    if not is_solid(study):
        return usual
    held = {name: getattr(study, name) for name in _OPTIONS}
    reading = dataclasses.replace(usual.reading, **held)
    return dataclasses.replace(usual, reading=reading, kind="rays")


def reference_setting(study: Study) -> Setting:
    """Texture 4x, float64, homography, on the study's own blocks; of solids 64 rays."""
    finest = Setting(REFERENCE, REFERENCE, study.measure, 4, "float64")
    if not is_solid(study):
        return finest
    reading = dataclasses.replace(finest.reading, reference_samples=64)
    return dataclasses.replace(finest, reading=reading, kind="rays")


def cases(
    study: Study,
    settings: Iterable[Setting],
    *,
    also: Sequence[AbstractTechnique] = (),
    is_with_samples: bool = False,
) -> tuple[list[Case], list[str]]:
    """List what to measure, the reference and the study's own setting first.

    **Arguments:**

    - `settings`: further ones; those like an earlier one are left out.
    - `also`: further techniques, in the reference and in the study's own setting only.
    - `is_with_samples`: SSAA(4) by 4 and by 16 samples; `also` must then name SSAA(4).

    **Returns:** the cases, textures in a row; names of settings that do not fit the
    camera.
    """
    base, reference = default_setting(study), reference_setting(study)
    chosen, misfits = [reference, base], []
    for setting in settings:
        try:
            setting.camera(study.display)
        except ValueError:
            misfits.append(setting.name)
            continue
        if not any(_is_same(setting, other) for other in chosen):
            chosen.append(setting)
    solid = is_solid(study)
    techniques = _distinct(study.techniques, solid)
    ids = [technique.id for technique in techniques]
    found = [
        Case(setting, technique, technique)
        for setting in chosen
        for technique in techniques
        # What reads no history does not know how it is read.
        if setting.knob != "history filter"
        or not isinstance(technique, AbstractSpatial)
        # Edges are not baked.
        if not (solid and setting.is_baked and technique.shades_once_per_pixel)
    ]
    for technique in _distinct(also, solid):
        if technique.id not in ids:
            for setting in (reference, base):
                turned = dataclasses.replace(setting, knob="technique")
                found.append(Case(turned, technique, technique))
    if is_with_samples and not solid:
        by = dataclasses.replace(base, name="4 samples", knob="samples")
        found.append(Case(by, EverySample(2), SSAA(4)))
        # Sixteen lookups by slices take minutes to compile.
        gather = dataclasses.replace(base.reading, sampler="gather")
        by = dataclasses.replace(by, name="16 samples, gather", reading=gather)
        found.append(Case(by, EverySample(4), SSAA(4)))
    order = list(dict.fromkeys(case.setting.texture() for case in found))
    return sorted(found, key=lambda case: order.index(case.setting.texture())), misfits


def _is_same(one: Setting, other: Setting) -> bool:
    return (one.fidelity(), one.measure) == (other.fidelity(), other.measure)


def _distinct(
    techniques: Sequence[AbstractTechnique], solid: bool
) -> list[AbstractTechnique]:
    """Techniques that differ on pictures, or all of them on solids."""
    found = [t if solid else t.on_pictures() for t in techniques]
    return list({technique.id: technique for technique in found}.values())
