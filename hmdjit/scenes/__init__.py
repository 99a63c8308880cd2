"""Scenes: what is there to be seen.

`base` has the contract, `patterns`, `rasters` and `pictures` the scenes, `baking` makes
a texture of one. `registry` knows names, and those of a study that names none;
`solid_set` those of solids.
Arrays of colours are gamma: uint8, uint16 or floating in `[0, 1]`, all else is refused;
`Photograph.read` says what is done with transparency, profiles and other things of
files. `study_set` needs the extra packages of `hmdjit[study]`; the other names need
them only when they read a file or draw text.
"""

from . import shapes as shapes
from . import surfaces as surfaces
from .baking import bake as bake
from .base import AbstractFlatScene as AbstractFlatScene
from .base import AbstractScene as AbstractScene
from .patterns import almost_uniform as almost_uniform
from .patterns import checkerboard as checkerboard
from .patterns import from_function as from_function
from .patterns import honeycomb as honeycomb
from .patterns import uniform as uniform
from .patterns import zone_plate as zone_plate
from .pictures import Panorama as Panorama
from .pictures import Photograph as Photograph
from .rasters import page_of_text as page_of_text
from .rasters import power_law_noise as power_law_noise
from .registry import CREDITS as CREDITS
from .registry import NAMES as NAMES
from .registry import by_name as by_name
from .registry import study_set as study_set
from .shapes import Movement as Movement
from .shapes import Object as Object
from .shapes import Sun as Sun
from .solid_set import arched_window as arched_window
from .solid_set import atrium as atrium
from .solid_set import blinds as blinds
from .solid_set import fence as fence
from .solid_set import flowers as flowers
from .solid_set import hairball as hairball
from .solid_set import hairball_shadow as hairball_shadow
from .solid_set import hut as hut
from .solid_set import moving_sphere as moving_sphere
from .solid_set import pipe as pipe
from .solid_set import solid_set as solid_set
from .solid_set import wall_text as wall_text
from .solids import Baked as Baked
from .solids import Solids as Solids
