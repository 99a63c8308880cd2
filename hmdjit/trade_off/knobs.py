"""The knobs of fidelity: settings that differ from a study's own in one of them.

Of pictures and of solids; a few combinations follow.
"""

import dataclasses
from collections.abc import Callable

from ..scenes.solids import Solids
from ..studies.measured_blocks import CentralCrop, Tiles, WholeFrame
from ..studies.study import Study
from .settings import Setting, default_setting, is_solid


def single_knobs(study: Study) -> list[Setting]:
    """List settings that differ from the study's in one knob each."""
    base = default_setting(study)

    def turned(name: str, knob: str, **values: object) -> Setting:
        return dataclasses.replace(base, name=name, knob=knob, **values)

    def read(name: str, knob: str, other: bool = False, **values: object) -> Setting:
        reading = dataclasses.replace(base.reading, **values)
        return turned(name, knob, reading=reading, is_other_device=other)

    sampler = "gather" if base.reading.sampler == "slices" else "slices"
    common = [
        *(
            turned(f"{n} tile{'s' * (n > 1)} of 64 px", "tiles", measure=Tiles(n, 64))
            for n in (1, 2, 4)
        ),
        *(
            turned(f"2 tiles of {px} px", "tile size", measure=Tiles(2, px))
            for px in (32, 128)
        ),
        turned("crop of 256 px", "crop", measure=CentralCrop(256)),
        turned("whole frame", "whole frame", measure=WholeFrame()),
        turned("half resolution", "resolution", shrink=2),
        turned("quarter resolution", "resolution", shrink=4),
    ]
    if is_solid(study):
        return [*common, *_of_solids(study, read, turned)]
    return [
        *common,
        *(turned(f"texture {k}x", "texture", oversampling=k) for k in (1, 2, 4)),
        read("texture nearest", "texture filter", texture_filter="nearest"),
        read("texture cubic", "texture filter", texture_filter="catmull_rom"),
        read("history nearest", "history filter", True, history_filter="nearest"),
        read("history cubic", "history filter", True, history_filter="catmull_rom"),
        read("warp affine", "warp", warp="affine"),
        read("warp shift", "warp", warp="shift"),
        turned("float64", "dtype", dtype="float64"),
        turned("bfloat16 texels", "dtype", dtype="bfloat16"),
        read(sampler, "sampler", sampler=sampler),
    ]


def _of_solids(study: Study, read: Callable, turned: Callable) -> list[Setting]:
    """List the knobs of ray casting; and baking, where a texture can stand for it."""
    (scene,) = study.scenes.values()
    found = [
        *(
            read(f"reference of {n} rays", "reference", reference_samples=n)
            for n in (4, 16, 64)
        ),
        *(
            read(f"reference every {m}", "reference frames", reference_every=m)
            for m in (1, 3, study.frames)
        ),
        turned("float64", "dtype", dtype="float64"),
    ]
    if isinstance(scene, Solids) and not scene.moves:
        found += [
            turned(f"baked, texture {k}x", "baking", oversampling=k, kind="baked")
            for k in (1, 2, 4)
        ]
    return found


def combinations(study: Study) -> list[Setting]:
    """List a few combinations that single knobs suggest."""
    if is_solid(study):
        return []
    fine = dataclasses.replace(
        default_setting(study), knob="combination", oversampling=4
    )
    affine = dataclasses.replace(fine.reading, warp="affine")
    return [
        dataclasses.replace(fine, name="4x, 2 tiles of 32 px", measure=Tiles(2, 32)),
        dataclasses.replace(fine, name="4x, 4 tiles of 32 px", measure=Tiles(4, 32)),
        dataclasses.replace(fine, name="4x, affine", reading=affine),
    ]


QUICK = (
    *("1 tile of 64 px", "texture 1x", "texture 4x", "warp shift"),
    *("reference of 4 rays", "reference every 1", "baked, texture 2x"),
)
"""Names of the settings that `--quick` measures besides reference and default."""
