"""How heads move: stochastic models, recorded traces, and fits of one to the other."""

from .parameters import Amplitude as Amplitude
from .parameters import Resonator as Resonator
from .process import HeadMotion as HeadMotion
from .trace import Trace as Trace
