"""Base classes of machine connections: wind-up under torque, stiffness, slip torque."""

from __future__ import annotations

import abc
import dataclasses
import inspect
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

from stiffopt.declaration import POSITIVE, Doc, Force, Torque, check_fields
from stiffopt.errors import InputError
from stiffopt.symbolic import Quantity, smooth_abs

# Smoothing width of |T| over torque_max [-].
_RELATIVE_SMOOTHING_WIDTH = 1e-3


@dataclass(frozen=True, kw_only=True)
class Connection(abc.ABC):
    """Torsional spring of a drivetrain, referred to its own shaft.

    The wind-up angle is the primary quantity: odd and monotone in torque, finite everywhere.
    Tangent stiffness dT/dphi and secant stiffness T/phi are derived from it and differ. Torque and
    preload may be floats, arrays or CasADi expressions.
    """

    kind: ClassVar[str]
    # Keys of references.bib that reports cite.
    references: ClassVar[tuple[str, ...]] = ("Joint2018",)
    # A preload may be given; the law depends on it.
    takes_preload: ClassVar[bool] = False
    needs_preload: ClassVar[bool] = False
    name: str = "connection"
    # Largest design torque on this shaft; sets the smoothing width.
    torque_max: Annotated[Torque, POSITIVE]
    preload: Annotated[
        Force | None, POSITIVE, Doc("Clamping force of one bolt or pin, or tension of one span.")
    ] = None

    def __post_init__(self) -> None:
        if self.preload is None and self.needs_preload:
            raise InputError(f"{self.owner}: preload is missing; give it in newtons.")
        if self.preload is not None and not self.takes_preload:
            raise InputError(
                f"{self.owner}: a connection of this kind takes no preload; remove it."
            )
        check_fields(self, self.owner)

    @property
    def owner(self) -> str:
        """Kind and name for messages."""
        return f"{self.kind} {self.name!r}"

    @abc.abstractmethod
    def windup(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the wind-up angle [rad] under `torque` [N m]: smooth, odd, monotone, 0 at 0.

        `preload` [N] replaces the connection's own; `smoothing` scales all smoothing widths
        (1 for results, larger in early continuation stages).
        """

    @abc.abstractmethod
    def tangent_compliance(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the tangent compliance d phi/dT [rad/(N m)]."""

    def tangent_stiffness(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the tangent stiffness dT/dphi [N m/rad]."""
        return 1 / self.tangent_compliance(torque, preload=preload, smoothing=smoothing)

    def secant_stiffness(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the secant stiffness T/phi [N m/rad]; at zero torque the tangent stiffness."""
        # The ratio is even and smooth, so 1e-9 torque_max replaces zero torque.
        away = smooth_abs(torque, 1e-9 * self.torque_max)
        return away / self.windup(away, preload=preload, smoothing=smoothing)

    def slip_torque(self, preload: Quantity | None = None) -> Quantity:
        """Return the torque of full slip [N m]; infinite if the connection cannot slip."""
        return math.inf

    def with_preload(self, preload: float) -> Self:
        """Return a copy with another preload [N]."""
        return dataclasses.replace(self, preload=preload)

    def _preload_or_own(self, preload: Quantity | None) -> Quantity:
        return self.preload if preload is None else preload


def connection_kinds(base: type[Connection] = Connection) -> dict[str, type[Connection]]:
    """Return every defined connection that robot files can name, by kind, sorted."""
    found: dict[str, type[Connection]] = {}
    for cls in base.__subclasses__():
        if "kind" in vars(cls) and not inspect.isabstract(cls):
            found[cls.kind] = cls
        found |= connection_kinds(cls)
    return dict(sorted(found.items()))


@dataclass(frozen=True, kw_only=True)
class ContactConnection(Connection):
    """Connection defined by its loading curve F(u), u = |T| > 0, smoothed through zero.

    phi(T) = T F(s)/s with s = sqrt(T^2 + eps^2) and eps = 1e-3 torque_max times the smoothing
    factor: the secant compliance F(s)/s is even and smooth, so phi is odd, smooth and, for every
    increasing F, monotone. (An odd extension of F(s) would be infinitely stiff at zero.)
    """

    references: ClassVar[tuple[str, ...]] = (
        *Connection.references,
        "YanKomvopoulos1998",
        "KogutEtsion2002",
        "Mindlin1949",
    )

    @abc.abstractmethod
    def loading_windup(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return the loading curve F(u) [rad] for u > 0 [N m]."""

    @abc.abstractmethod
    def loading_compliance(self, torque: Quantity, preload: Quantity) -> Quantity:
        """Return dF/du [rad/(N m)] for u > 0 [N m]."""

    def _smooth_magnitude(self, torque: Quantity, smoothing: Quantity) -> Quantity:
        return smooth_abs(torque, _RELATIVE_SMOOTHING_WIDTH * self.torque_max * smoothing)

    def windup(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the wind-up angle [rad]; see `Connection.windup`."""
        size = self._smooth_magnitude(torque, smoothing)
        return torque / size * self.loading_windup(size, self._preload_or_own(preload))

    def tangent_compliance(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Return the tangent compliance d phi/dT in closed form [rad/(N m)]."""
        force = self._preload_or_own(preload)
        size = self._smooth_magnitude(torque, smoothing)
        share = (torque / size) ** 2
        secant = self.loading_windup(size, force) / size
        return (1 - share) * secant + share * self.loading_compliance(size, force)


@dataclass(frozen=True, kw_only=True)
class LinearConnection(Connection):
    """Connection whose wind-up is proportional to torque."""

    @property
    @abc.abstractmethod
    def compliance(self) -> float:
        """Wind-up per torque [rad/(N m)]."""

    def windup(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Wind-up angle [rad]."""
        return self.compliance * torque

    def tangent_compliance(
        self, torque: Quantity, *, preload: Quantity | None = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Constant compliance [rad/(N m)], shape as `torque`."""
        return self.compliance + 0.0 * torque
