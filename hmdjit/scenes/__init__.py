"""Scenes: what is there to be seen.

`base` has the contract, `patterns`, `rasters` and `pictures` the scenes, `baking` makes
a texture of one. `study_set` lists those of a study that names none.
Arrays of colours are gamma: uint8, uint16 or floating in `[0, 1]`, all else is refused;
`Photograph.read` says what is done with transparency, profiles and other things of
files. `study_set` needs the extra packages of `hmdjit[study]`; the other names need
them only when they read a file or draw text.
"""

from .baking import bake as bake
from .base import AbstractFlatScene as AbstractFlatScene
from .base import AbstractScene as AbstractScene
from .patterns import almost_uniform as almost_uniform
from .patterns import checkerboard as checkerboard
from .patterns import honeycomb as honeycomb
from .patterns import uniform as uniform
from .patterns import zone_plate as zone_plate
from .pictures import Panorama as Panorama
from .pictures import Photograph as Photograph
from .rasters import page_of_text as page_of_text
from .rasters import power_law_noise as power_law_noise
from .solids import Baked as Baked
from .study_set import CREDITS as CREDITS
from .study_set import study_set as study_set
