"""hmdjit: how much the picture flickers when a head tries to hold still.

Simulates viewing sessions of a magnified picture in a VR headset, applies anti-aliasing
techniques to them, and reports how much each flickers, how much detail it costs, and
how sure that is.
"""

import os as _os
import signal as _signal
import sys as _sys
import typing as _typing


def _stop(*_: object) -> _typing.NoReturn:
    """End the process at once: an exception may be swallowed where it is raised."""
    _os.write(2, b"hmdjit: stopped.\n")
    _os._exit(130)


# Of the command line, unless it ignores interruptions: imports below take seconds.
_program = _sys.orig_argv[-len(getattr(_sys, "argv", ())) :][:1]
_name = _os.path.splitext(_os.path.basename("".join(_program)))[0]
_is_default = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
if _name in ("hmdjit", "-mhmdjit") and _is_default:
    _signal.signal(_signal.SIGINT, _stop)

from . import curves as curves
from . import metrics as metrics
from . import quaternion as quaternion
from . import scenes as scenes
from . import techniques as techniques
from ._version import __version__ as __version__
from .camera import Camera as Camera
from .camera import Region as Region
from .frames.frame import Frame as Frame
from .frames.motion import Motion as Motion
from .frames.texture import Texture as Texture
from .head_fitting.fitting import fit_heads as fit_heads
from .head_motion import HeadMotion as HeadMotion
from .head_motion import Trace as Trace
from .head_motion.replay import Replay as Replay
from .simulation.apply import apply as apply
from .simulation.session import Result as Result
from .simulation.simulate import simulate as simulate
from .studies.study import Study as Study
from .sweep.sweep import Sweep as Sweep
