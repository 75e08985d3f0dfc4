"""Wind-up of a whole joint in a few operations, for the trajectory optimiser.

A joint has up to ten rough contacts; written out they cost a thousand operations an instant, and
second derivatives five times that. With fixed preloads they are one odd function of one torque:
phi(T) = T G(s), s = sqrt(T^2 + eps^2), where the secant compliance G depends smoothly on ln s. A
Chebyshev series of ln G, fitted to the wind-up of the smooth chain, replaces them with a stated
error. The reducer keeps its closed form.

The exact law is not used here: it is the certificate's, which judges the result. Compared with it
the contacts' smooth laws are off by up to 0.5 % ("log_cubic") or 5 % ("power_law") of a contact's
wind-up over the range of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import OutOfValidityError
from stiffopt.symbolic import Quantity, elementwise_derivative, smooth_abs, softplus

# Range of the fit: shares of `torque_max`, and of the least slip torque.
_MIN_TORQUE_RATIO = 2e-5
_MAX_TORQUE_RATIO = 1.3
_MAX_SLIP_RATIO = 0.95
# Smoothing width about zero torque, as a share of `torque_max`.
_SMOOTHING_RATIO = 1e-3
# Degrees tried in order, until the relative error of the wind-up is below the target.
_FIT_DEGREES = (10, 14, 18, 24)
_TARGET_FIT_ERROR = 1e-4
_MAX_FIT_ERROR = 5e-3


@dataclass(frozen=True)
class CompactChain:
    """Compact form of a chain with its own preloads.

    Raises `OutOfValidityError`: the fit misses the smooth chain by more than 0.5 %.
    """

    chain: Chain
    # Of the joint [N m]; the fit holds from 2e-5 to 1.3 of it, or to 0.95 of the least slip torque.
    # Beyond, the secant compliance is constant; the transition takes the last tenth and is 1 % off
    # at the end.
    torque_max: float

    @cached_property
    def _fit_windup(self) -> tuple[np.ndarray, float, float, float]:
        """Chebyshev coefficients of ln G over ln s, the range of ln s, and the largest error."""
        reducers = self._split_reducers
        fitted = tuple(s for s in self.chain.stages if s not in reducers)
        contacts = replace(self.chain, stages=fitted)
        if not contacts.stages:
            return np.zeros(0), 0.0, 1.0, 0.0
        slip = min(contacts.slip_torques().values(), default=np.inf)
        low = np.log(_MIN_TORQUE_RATIO * self.torque_max)
        high = np.log(min(_MAX_TORQUE_RATIO * self.torque_max, _MAX_SLIP_RATIO * slip))
        nodes = np.cos(np.pi * (np.arange(200) + 0.5) / 200)
        torque = np.exp(low + (high - low) * (nodes + 1) / 2)
        between = np.exp(np.linspace(low, high, 401))
        # Without smoothing about zero: the compact form has its own.
        log_g = np.log(contacts.windup(torque, smoothing=0.0) / torque)
        check = np.log(contacts.windup(between, smoothing=0.0) / between)
        places = 2 * (np.log(between) - low) / (high - low) - 1
        for degree in _FIT_DEGREES:
            coefficients = chebyshev.chebfit(nodes, log_g, degree)
            error = float(np.max(np.abs(chebyshev.chebval(places, coefficients) - check)))
            if error < _TARGET_FIT_ERROR:
                break
        if error > _MAX_FIT_ERROR:
            raise OutOfValidityError(
                "relative error of the compact wind-up",
                error,
                0.0,
                _MAX_FIT_ERROR,
                "An element of this joint has a law too sharp for it; check its dimensions.",
            )
        return coefficients, float(low), float(high), error

    @property
    def _split_reducers(self) -> tuple[Stage, ...]:
        """Stages in their closed form: reducers in series with the rest."""
        return tuple(
            s for s in self.chain.stages if s.element.kind == "reducer" and s.group is None
        )

    @property
    def error(self) -> float:
        """Largest relative error of the contacts' wind-up against the smooth chain."""
        return self._fit_windup[3]

    def windup(self, torque: Quantity, *, smoothing: Quantity = 1.0) -> Quantity:
        """Wind-up of the joint [rad] under a torque [N m]; smooth, odd, monotone.

        `smoothing` scales the smoothing widths: 1e-3 of torque_max about zero, the reducer's own
        about its steps of stiffness.
        """
        total = torque * self._secant_compliance(torque, smoothing)
        for stage in self._split_reducers:
            total = total + stage.windup(torque, None, smoothing)
        return total

    def tangent_compliance(self, torque: Quantity, *, smoothing: Quantity = 1.0) -> Quantity:
        """Slope of the wind-up [rad/(N m)]."""
        return elementwise_derivative(lambda t: self.windup(t, smoothing=smoothing), torque)

    def _secant_compliance(self, torque: Quantity, smoothing: Quantity) -> Quantity:
        """Contacts' wind-up over torque [rad/(N m)], by Clenshaw's recurrence."""
        coefficients, low, high, _ = self._fit_windup
        if not coefficients.size:
            return 0.0
        size = smooth_abs(torque, _SMOOTHING_RATIO * self.torque_max * smoothing)
        place = 2.0 * (np.log(size) - low) / (high - low) - 1.0
        # Saturates smoothly at the end of the fit, so that it is never extrapolated.
        corner = 0.01
        place = place - corner * softplus((place - 1.0) / corner)
        after, last = 0.0, 0.0
        for c in coefficients[:0:-1]:
            after, last = 2.0 * place * after - last + c, after
        return np.exp(place * after - last + coefficients[0])
