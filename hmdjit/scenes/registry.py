"""Scenes by name, and those of a study that names none."""

import functools
import os
from collections.abc import Callable
from pathlib import Path

from .. import _checks, _python_files
from .base import AbstractScene
from .patterns import almost_uniform, checkerboard
from .pictures import Photograph
from .rasters import page_of_text, power_law_noise
from .solid_set import SOLIDS

CREDITS = {
    "astronaut": ("Eileen Collins; NASA", "public domain"),
    "cat": ("Chelsea the cat; Stefan van der Walt", "CC0"),
    "coffee": ("Rachel Michetti, courtesy of Pikolo Espresso Bar", "CC0"),
    "galaxies": ("Hubble eXtreme Deep Field; NASA, HubbleSite", "public domain"),
    "grass": ("Grass 01; linolafett, DeviantArt", "CC0"),
    "retina": ("Mikael Häggström, WikiJournal of Medicine 1 (2), 2014", "CC0"),
    "rocket": ("Falcon 9 carrying DSCOVR; SpaceX", "public domain"),
}
"""Credit and licence of each photograph of `study_set`, as scikit-image states them."""


_IMAGE_OF = {"galaxies": "hubble_deep_field"}  # elsewhere scikit-image's name is ours


def _photograph(name: str) -> Photograph:
    try:
        import skimage.data
    except ImportError as error:
        raise ImportError(
            "The study's photographs need scikit-image: install `hmdjit[study]`."
        ) from error
    return Photograph.of(getattr(skimage.data, _IMAGE_OF.get(name, name))(), name=name)


_PICTURES: dict[str, Callable[[], AbstractScene]] = {
    **{name: functools.partial(_photograph, name) for name in CREDITS},
    "text": page_of_text,
    "checkerboard": checkerboard,
    "noise": power_law_noise,
    "almost_uniform": almost_uniform,
}

NAMES = tuple(dict.fromkeys([*_PICTURES, *SOLIDS]))
"""Names of all scenes, those of the default study first."""


def study_set() -> dict[str, AbstractScene]:
    """Eleven scenes in the place of Kim et al.'s eleven pictures, which are not public.

    Seven are photographs that the scikit-image package itself carries (`CREDITS`), one
    texel per display pixel in the centre; four are made up: text, a checkerboard, noise
    and an almost uniform picture.

    **Returns:** scenes by their names, photographs first.

    **Errors:** `ImportError` without scikit-image or Pillow.
    """
    return {name: make() for name, make in _PICTURES.items()}


def by_name(name: str | os.PathLike[str]) -> AbstractScene:
    """Scene of a name such as `coffee` or `fence`, of a file, or of one's own making.

    `A.png` is a flat picture; `my_scene.py:scene` runs a Python file and takes a scene,
    or what a function without arguments returns, from it.

    **Errors:** `ValueError` naming the known scenes, with the nearest as a suggestion,
    or the file and what is wrong with it.
    """
    name = os.fspath(name)
    if own := _python_files.split(name):
        return _own(*own)
    if name not in NAMES and (Path(name).suffix or Path(name).is_file()):
        return Photograph.read(name)
    _checks.one_of("scenes", name, NAMES)
    return (_PICTURES.get(name) or SOLIDS[name])()


def _own(file: Path, name: str) -> AbstractScene:
    """Scene of a user's own file."""
    found = _python_files.load(file, name)
    if callable(found):
        found = _python_files.made(file, found, name)
    if not isinstance(found, AbstractScene):
        raise ValueError(
            f"{file}:{name} must be a scene, as hj.scenes.from_function(f) makes one, "
            f"or return it, got {type(found).__name__}."
        )
    return found
