"""How heads move: stochastic models and recorded traces."""

from .process import HeadMotion as HeadMotion
from .trace import Trace as Trace
