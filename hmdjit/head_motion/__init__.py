"""How heads move: stochastic models, recorded traces, and fits of one to the other."""

from .process import Amplitude as Amplitude
from .process import HeadMotion as HeadMotion
from .process import Resonator as Resonator
from .trace import Trace as Trace
