"""How heads move: a stochastic model (`process`), recorded traces (`trace`, `replay`).

Named heads are tables in `presets.toml`; `head_fitting` fits the model to traces.
"""

from .parameters import Amplitude as Amplitude
from .parameters import Resonator as Resonator
from .process import HeadMotion as HeadMotion
from .trace import Trace as Trace
