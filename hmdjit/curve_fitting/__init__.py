"""Fitting blending curves: as little flicker as a loss of detail allows."""

from .fitting import fit as fit
from .recovery import recover as recover
from .results import CurveFit as CurveFit
from .results import gain_at_equal_detail as gain_at_equal_detail
from .search import NoFitError as NoFitError
from .space import CurveSpace as CurveSpace
