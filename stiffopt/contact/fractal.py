"""Normal stiffness of a rough contact as a function of pressure: the fractal model in closed form.

The largest spot a_L is the hidden variable: load and stiffness are sums over all spots up to it.
This is the exact law (NumPy only); optimisation uses the smooth fits of `surrogate`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiffopt.contact.spots import SpotLaw, total_force, total_stiffness
from stiffopt.contact.surface import SurfacePair
from stiffopt.errors import InputError

# Inversion of the pressure: limit of its Newton steps, and relative step at which it has converged.
_MAX_NEWTON_STEPS = 200
_RELATIVE_TOLERANCE = 1e-14
# Table of initial values, over ln p: 1 mPa to 10 TPa.
_TABLE_MEAN_LOG_PRESSURE, _TABLE_HALF_WIDTH_LOG_PRESSURE = np.log(1e5), np.log(1e8)
_TABLE_SIZE = 2001


@dataclass(frozen=True)
class FractalLaw:
    """Pressure and stiffness of a surface pair through the area of its largest spot.

    Without the factor psi of Wang and Komvopoulos (1994) in the size distribution: it changes
    k_n(p) by about 3 %, which the fractal roughness absorbs.
    """

    surface: SurfacePair

    @property
    def spots(self) -> tuple[SpotLaw, ...]:
        """Spot laws from plastic to elastic."""
        return self.surface.spots

    @property
    def elastic_limit(self) -> float:
        """Spots above this truncated area are elastic [m^2]."""
        return self.spots[-1].lower

    @property
    def plastic_limit(self) -> float:
        """Spots below this truncated area are fully plastic [m^2]."""
        return self.spots[0].upper

    def pressure(self, largest_spot: np.ndarray) -> np.ndarray:
        """Nominal pressure [Pa] on the reference patch when the largest spot is a_L [m^2]."""
        force = total_force(self.spots, largest_spot, self.surface.fractal_dimension)
        return force / self.surface.reference_area

    def stiffness(self, largest_spot: np.ndarray) -> np.ndarray:
        """Normal stiffness per area [N/m^3] when the largest spot is a_L [m^2].

        Of first loading or of reloading, by the surface's `loading`.
        """
        total = total_stiffness(self.spots, largest_spot, self.surface.fractal_dimension)
        return total / self.surface.reference_area

    def largest_spot(self, pressure: np.ndarray) -> np.ndarray:
        """Invert `pressure`: area of the largest spot [m^2], shape as `pressure` (all above 0)."""
        target = np.asarray(pressure, dtype=float)
        if not np.all((target > 0.0) & np.isfinite(target)):
            raise InputError(
                "fractal law: the largest spot exists for finite pressures above 0 only; "
                f"the smallest given is {np.min(target):g} Pa."
            )
        return np.asarray(np.exp(self._log_spot(np.log(target))))

    def _log_spot(self, goal: np.ndarray) -> np.ndarray:
        """Logarithm of the largest spot for logarithms of pressures, by bracketed Newton steps."""
        x, lower, upper = self._initial_bracket(goal)
        for _ in range(_MAX_NEWTON_STEPS):
            largest = np.exp(x)
            pressure = self.pressure(largest)
            excess = np.log(pressure) - goal
            lower = np.where(excess < 0.0, x, lower)
            upper = np.where(excess > 0.0, x, upper)
            # Slope of ln P over ln a_L: the distribution's own growth plus the newest spots.
            step = excess / self._log_slope(largest, pressure)
            following = x - step
            # A converged value is accepted even if its last step ends on the bracket.
            arrived = np.abs(step) <= _RELATIVE_TOLERANCE * np.maximum(1.0, np.abs(x))
            inside = arrived | ((following > lower) & (following < upper))
            x = np.where(inside, following, 0.5 * (lower + upper))
            if np.all(arrived):
                return np.asarray(x)
        raise InputError(
            "fractal law: no largest spot was found for pressures of "
            f"{np.exp(goal.min()):.3g} to {np.exp(goal.max()):.3g} Pa. Check areas, preload and "
            "surface of the contact."
        )

    def _initial_bracket(self, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return an initial value and a bracket, from the table of usual pressures or searched."""
        if np.all(np.abs(goal - _TABLE_MEAN_LOG_PRESSURE) < _TABLE_HALF_WIDTH_LOG_PRESSURE):
            spots, goals = self._tabulate_pressure
            right = np.searchsorted(goals, goal, side="right")
            return np.interp(goal, goals, spots), spots[right - 1], spots[right]
        return self._search_bracket(goal)

    def _search_bracket(self, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # If every spot were plastic the load would be hardness times real area.
        dimension = self.surface.fractal_dimension
        area = np.exp(goal) * self.surface.reference_area / self.surface.softer.hardness
        start = np.log(area * (3 - dimension) / (dimension - 1))
        lower, upper = self._bracket_spot_area(start, goal)
        return np.clip(start, lower, upper), lower, upper

    @cached_property
    def _tabulate_pressure(self) -> tuple[np.ndarray, np.ndarray]:
        """Table of ln a_L, equally spaced, and ln p that covers the usual pressures."""
        _, lower, upper = self._search_bracket(
            _TABLE_MEAN_LOG_PRESSURE
            + np.array([-_TABLE_HALF_WIDTH_LOG_PRESSURE, _TABLE_HALF_WIDTH_LOG_PRESSURE])
        )
        spots = np.linspace(lower[0], upper[1], _TABLE_SIZE)
        return spots, np.log(self.pressure(np.exp(spots)))

    def _bracket_spot_area(
        self, start: np.ndarray, goal: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = start - 1.0, start + 1.0
        reach = 1.0
        for _ in range(60):
            low = np.log(self.pressure(np.exp(lower))) > goal
            high = np.log(self.pressure(np.exp(upper))) < goal
            if not (np.any(low) or np.any(high)):
                break
            reach *= 2.0
            lower = np.where(low, start - reach, lower)
            upper = np.where(high, start + reach, upper)
        return lower, upper

    def _log_slope(self, largest: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        half = (self.surface.fractal_dimension - 1) / 2
        force = np.zeros_like(largest)
        for law in self.spots:
            inside = (largest > law.lower) & (largest <= law.upper)
            force = np.where(inside, law.force_factor * largest**law.force_exponent, force)
        newest = half * force / self.surface.reference_area
        return np.asarray(half + newest / pressure)

    def normal_stiffness_per_area(self, pressure: np.ndarray) -> np.ndarray:
        """Exact k_n(p) [N/m^3] for nominal pressures p [Pa], shape as `pressure`.

        Zero at zero pressure (no contact) and below the pressure where all spots are plastic.
        """
        p = np.asarray(pressure, dtype=float)
        loaded = p > 0.0
        safe = np.where(loaded, p, 1.0)
        return np.where(loaded, self.stiffness(self.largest_spot(safe)), 0.0)
