"""The scenes of a study that names none."""

from .base import AbstractScene
from .patterns import almost_uniform, checkerboard
from .pictures import Photograph
from .rasters import page_of_text, power_law_noise

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

NAMES = (*CREDITS, "text", "checkerboard", "noise", "almost_uniform")
"""Names of `study_set`, in its order."""

_IMAGE_OF = {"galaxies": "hubble_deep_field"}  # elsewhere scikit-image's name is ours


def study_set() -> dict[str, AbstractScene]:
    """Eleven scenes in the place of Kim et al.'s eleven pictures, which are not public.

    Seven are photographs that the scikit-image package itself carries (`CREDITS`), one
    texel per display pixel in the centre; four are made up: text, a checkerboard, noise
    and an almost uniform picture.

    **Returns:** scenes by their names, photographs first.

    **Errors:** `ImportError` without scikit-image or Pillow.
    """
    try:
        import skimage.data
    except ImportError as error:
        raise ImportError(
            "The study's photographs need scikit-image: install `hmdjit[study]`."
        ) from error
    scenes: list[AbstractScene] = [
        Photograph.of(getattr(skimage.data, _IMAGE_OF.get(name, name))(), name=name)
        for name in CREDITS
    ]
    scenes += [page_of_text(), checkerboard(), power_law_noise(), almost_uniform()]
    return {scene.name: scene for scene in scenes}
