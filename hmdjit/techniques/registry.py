"""Techniques by their ids.

An id is the family's name and what is not its default, such as `ssaa2_gamma`.
"""

import dataclasses
import difflib
import re

from ..sample_patterns import MULTISAMPLE_COUNTS
from . import curve_file
from .base import SPACES, AbstractSpatial, AbstractTechnique
from .freeze import Freeze
from .head_movement import HeadMovement
from .spatial import MSAA, SSAA, NoAntialiasing

IDS = (
    "none",
    "freeze",
    *(f"msaa{n}" for n in MULTISAMPLE_COUNTS[1:]),
    *(f"ssaa{n}" for n in (2, 3, 4, 8)),
    *("ssaa2_gamma", "ssaa2_lanczos2", "ssaa2_lanczos2_gamma"),
    "head_movement",
)
"""Ids that are listed; `ssaa` takes any factor, `head_movement+ssaa2` stacks,
`head_movement:curve.toml` reads a file."""

_SSAA = r"ssaa([1-9]\d?)(?:_(lanczos2)(?:_taps(11))?)?(?:_(gamma))?"

_NAMED: dict[str, AbstractTechnique] = {
    technique.id: technique
    for technique in (
        NoAntialiasing(),
        Freeze(),
        *(MSAA(n, space) for n in MULTISAMPLE_COUNTS for space in SPACES),
    )
}


def by_id(id: str) -> AbstractTechnique:
    """Technique of an id such as `none`, `msaa4`, `ssaa2`, `head_movement+ssaa2`.

    `head_movement:curve.toml` and `head_movement:curve.toml+ssaa2` read a file (see
    `curve_file`), whose name becomes the label.

    **Errors:** `ValueError` naming the known ids, with the nearest as a suggestion, or
    the file and what is wrong with it.
    """
    # A path may have a plus of its own, before a slash or a dot.
    found = re.fullmatch(r"([^:+]*)(?::(.+?))?(?:\+(\w*))?", id)
    name, path, resolve = found.groups() if found else (id, None, None)
    if name == "head_movement":
        spatial = None if resolve is None else by_id(resolve)
        if isinstance(spatial, AbstractSpatial | None):
            plain = HeadMovement() if path is None else curve_file.read(path)
            return dataclasses.replace(plain, resolve=spatial)
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
    near = difflib.get_close_matches(id, IDS, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise ValueError(f"technique must be one of {', '.join(IDS)}, got {id!r}.{hint}")
