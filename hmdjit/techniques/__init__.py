"""Anti-aliasing techniques: one file per technique or close family.

`registry` knows ids; what a technique is, is in `technique_contract`. The arithmetic of
Kim et al. is in `reprojection` and `blending`, by equation number; what reads
neighbours, and what the temporal ones share, is in `filters`.
"""

from ..technique_contract.base import AbstractSpatial as AbstractSpatial
from ..technique_contract.base import AbstractTechnique as AbstractTechnique
from ..technique_contract.base import AbstractTemporal as AbstractTemporal
from ..technique_contract.check import check as check
from ..technique_contract.display_stages import AbstractStage as AbstractStage
from ..technique_contract.display_stages import Displayed as Displayed
from ..technique_contract.display_stages import MotionBlur as MotionBlur
from ..technique_contract.display_stages import Sharpening as Sharpening
from . import curve_file as curve_file
from .amortized import Amortized as Amortized
from .freeze import Freeze as Freeze
from .fxaa import FXAA as FXAA
from .head_movement import HeadMovement as HeadMovement
from .inside import Inside as Inside
from .karis import Karis as Karis
from .morphological import MLAA as MLAA
from .morphological import SMAA as SMAA
from .registry import IDS as IDS
from .registry import by_id as by_id
from .sobel_taa import SobelTAA as SobelTAA
from .spatial import MSAA as MSAA
from .spatial import SSAA as SSAA
from .spatial import AccumulationBuffer as AccumulationBuffer
from .spatial import NoAntialiasing as NoAntialiasing
from .thesis_baseline import ThesisBaseline as ThesisBaseline
from .tidoaa import TIDOAA as TIDOAA
from .two_frame import TwoFrame as TwoFrame
from .uncharted4 import Uncharted4 as Uncharted4
