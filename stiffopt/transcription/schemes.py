"""Names of the transcription schemes."""

from __future__ import annotations

from stiffopt.errors import ProblemError, nearest
from stiffopt.transcription.hermite_simpson import HermiteSimpson
from stiffopt.transcription.piecewise_linear import IntegratorChain, PiecewiseLinear
from stiffopt.transcription.radau import Radau
from stiffopt.transcription.scheme import Scheme

METHODS = ("piecewise_linear", "hermite_simpson", "radau")
_METHOD_ALIASES = {"piecewise_linear_acceleration": "piecewise_linear"}


def scheme_of(method: str, degree: int = 3, integrators: int = 2) -> Scheme:
    """Return the scheme of a name.

    `degree` is the number of Radau points in an interval, `integrators` that of integrators between
    a control and its position.
    """
    name = _METHOD_ALIASES.get(method, method)
    if name == "piecewise_linear":
        return PiecewiseLinear() if integrators == 2 else IntegratorChain()
    if name == "hermite_simpson":
        return HermiteSimpson()
    if name == "radau":
        return Radau(degree)
    raise ProblemError(
        f"transcription {method!r} is not known. {nearest(method, [*METHODS, *_METHOD_ALIASES])}"
    )
