"""Techniques by their ids.

An id is the family's name and what is not its default, such as `ssaa2_gamma`.
"""

import dataclasses
import difflib
import functools
import re
from itertools import product
from pathlib import Path

from .. import _python_files
from ..filters.aliasing import DEPTH_RANGES
from ..sample_patterns import MULTISAMPLE_COUNTS
from ..technique_contract.base import (
    OFF_SCREEN,
    SPACES,
    AbstractSpatial,
    AbstractTechnique,
)
from ..technique_contract.check import check
from ..technique_contract.display_stages import (
    AbstractStage,
    Displayed,
    MotionBlur,
    Sharpening,
)
from ..technique_contract.shapes import check_contract
from . import curve_file, fxaa, morphological
from .amortized import Amortized
from .freeze import Freeze
from .fxaa import FXAA
from .head_movement import DYNAMIC, HeadMovement
from .inside import Inside
from .karis import Karis
from .morphological import EDGES, MLAA, SMAA
from .sobel_taa import DEPTH_HISTORIES, SobelTAA
from .spatial import MSAA, SSAA, AccumulationBuffer, NoAntialiasing
from .thesis_baseline import ThesisBaseline
from .tidoaa import TIDOAA
from .two_frame import TwoFrame
from .uncharted4 import Uncharted4

IDS = (
    "none",
    "freeze",
    *(f"msaa{n}" for n in MULTISAMPLE_COUNTS[1:]),
    *(f"ssaa{n}" for n in (2, 3, 4, 8)),
    *("ssaa2_gamma", "ssaa2_lanczos2", "ssaa2_lanczos2_gamma"),
    *("accumulation16", "accumulation128"),
    "fxaa",
    "fxaa39",
    "mlaa",
    *("smaa", "smaa_low", "smaa_medium", "smaa_ultra", "smaa_ultra_color"),
    "head_movement",
    *("amortized", "amortized_subpixel", "two_frame", "inside", "inside_ycocg"),
    *(
        "thesis_baseline",
        "uncharted4",
        "karis",
        "tidoaa",
        "tidoaa_subcell",
        "sobel_taa",
    ),
    *(f"head_movement_{choice}" for choice in ("rigid", *DYNAMIC[1:])),
)
"""Ids that are listed; `ssaa` takes any factor, `accumulation` any number of samples,
`head_movement+ssaa2` stacks, `head_movement:curve.toml` reads a file, as
`head_movement_rigid_frames:curve.toml+ssaa2` says more choices. All that mix
colours take `_gamma` or `_linear`, `fxaa` its presets' numbers. Behind any stands a
stage of display, `none+sharpen`."""

_SSAA = r"ssaa([1-9]\d?)(?:_(lanczos2)(?:_taps(11))?)?(?:_(gamma))?"

_BOTH = (False, True)
_NAMED: dict[str, AbstractTechnique] = {
    technique.id: technique
    for technique in (
        NoAntialiasing(),
        Freeze(),
        *(MSAA(n, space) for n in MULTISAMPLE_COUNTS for space in SPACES),
        *(FXAA(*choices) for choices in product(fxaa.PRESETS, SPACES)),
        *map(MLAA, SPACES),
        *(SMAA(*choices) for choices in product(morphological.PRESETS, EDGES, SPACES)),
        *(
            SobelTAA(span, history, off_screen, jitter=jitter)
            for span, history in product(DEPTH_RANGES, DEPTH_HISTORIES)
            for off_screen, jitter in product(OFF_SCREEN, _BOTH)
        ),
        *(TIDOAA(c, space, jitter=j) for c, space, j in product(_BOTH, SPACES, _BOTH)),
        *(Amortized(subpixel=s, jitter=j) for s, j in product(_BOTH, _BOTH)),
        *(
            Inside(ycocg, blur, off_screen, jitter=jitter)
            for ycocg, blur in product(_BOTH, _BOTH)
            for off_screen, jitter in product(OFF_SCREEN, _BOTH)
        ),
        *(ThesisBaseline(o, jitter=j) for o, j in product(OFF_SCREEN, _BOTH)),
        *(kind(jitter=j) for kind in (TwoFrame, Uncharted4, Karis) for j in _BOTH),
    )
}

_HEAD_MOVEMENT = rf"head_movement(_rigid)?(?:_({'|'.join(DYNAMIC[1:])}))?"

_STAGES: dict[str, AbstractStage] = {
    stage.id: stage for stage in (Sharpening(), Sharpening("xu"), MotionBlur())
}
_BLUR = r"motion_blur(\d+(?:\.\d+)?)?(?:_taps([1-9]\d*))?"


def by_id(id: str) -> AbstractTechnique:
    """Technique of an id such as `none`, `msaa4`, `ssaa2`, `head_movement+ssaa2`.

    `head_movement:curve.toml` and `head_movement:curve.toml+ssaa2` read a file (see
    `curve_file`), whose name becomes the label. `my_taa.py:MyTAA` runs a Python file
    and takes a class, made without arguments, or a technique from it, if it keeps the
    laws of `check`. `+sharpen`, `+sharpen_xu` and `+motion_blur` behind a technique are
    stages of display.

    **Errors:** `ValueError` naming the known ids, with the nearest as a suggestion, or
    the file and what is wrong with it.
    """
    before, plus, last = id.rpartition("+")
    if plus and (stage := _stage(last)):
        return Displayed(by_id(before), stage)
    if own := _python_files.split(id):
        return _own(*own)
    # A path may have a plus of its own, before a slash or a dot.
    found = re.fullmatch(r"([^:+]*)(?::(.+?))?(?:\+(\w*))?", id)
    name, path, resolve = found.groups() if found else (id, None, None)
    if match := re.fullmatch(_HEAD_MOVEMENT, name):
        spatial = None if resolve is None else by_id(resolve)
        if isinstance(spatial, AbstractSpatial | None):
            plain = HeadMovement() if path is None else curve_file.read(path)
            return dataclasses.replace(
                plain,
                resolve=spatial,
                reprojects="rigid" if match[1] else "rotation",
                dynamic=match[2] or "none",
            )
    elif path is None and resolve is None:
        if name in _NAMED:
            return _NAMED[name]
        if match := re.fullmatch(_SSAA, name):
            factor, lanczos2, taps, gamma = match.groups()
            return SSAA(
                int(factor),
                gamma or "linear",
                lanczos2 or "box",
                int(taps or 0) or "exact",
            )
        if match := re.fullmatch(r"accumulation([1-9]\d*)(?:_(gamma))?", name):
            return AccumulationBuffer(int(match[1]), match[2] or "linear")
    known = [*IDS, *_NAMED, *(f"none+{stage}" for stage in _STAGES)]
    near = difflib.get_close_matches(id, known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise ValueError(
        f"technique must be one of {', '.join(IDS)} (what is a default is not said), "
        f"behind any +{', +'.join(_STAGES)}, got {id!r}.{hint}"
    )


@functools.cache
def _own(file: Path, name: str) -> AbstractTechnique:
    """Technique of a user's own file, checked."""
    found = _python_files.load(file, name)
    if isinstance(found, type) and issubclass(found, AbstractTechnique):
        found = _python_files.made(file, found, name)
    if not isinstance(found, AbstractTechnique):
        raise ValueError(
            f"{file}:{name} must be a subclass of hj.techniques.AbstractTechnique, or "
            f"a technique, got {getattr(found, '__name__', type(found).__name__)}."
        )
    # No small frame stands for what a scene gives beside colour.
    laws = check if found.needs == {"color"} else check_contract
    _python_files.made(file, functools.partial(laws, found), name)
    return found


def _stage(id: str) -> AbstractStage | None:
    if id in _STAGES:
        return _STAGES[id]
    if match := re.fullmatch(_BLUR, id):
        return MotionBlur(float(match[1] or 25), int(match[2] or 64))
    return None
