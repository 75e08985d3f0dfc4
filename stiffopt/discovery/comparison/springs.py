"""Joint springs between motors that move as recorded and links that follow.

A link motion that is consistent with the springs at every sample is solved by steps linear about a
motion nearby.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.vibration import LinkMotion, Vibration, slow_filter
from stiffopt.elastic.response import ElasticResponse

# Share of the largest torque; smaller changes have no mean slope.
_MIN_TORQUE_CHANGE = 1e-9


@dataclass(frozen=True, eq=False)
class SpringLaw:
    """Tabulated torque over deflection of a spring with play, piecewise linear.

    A link that crosses a play carries no torque: deflection over torque jumps there, while torque
    over deflection is continuous.
    """

    carried: np.ndarray  # (m,) torques, increasing [N m]
    deflection: np.ndarray  # (m,) deflections under them, increasing [rad]
    windup: np.ndarray  # (m,) elastic part of the deflections [rad]

    @cached_property
    def max_stiffness(self) -> float:
        """Largest tangent stiffness [N m/rad]."""
        return float(1.0 / np.min(self._interval_compliance))

    def share_of_play(self, deflection: np.ndarray) -> np.ndarray:
        """Return the share of free travel in the rates of deflections (k,)."""
        cell = self._locate_interval(self.deflection, deflection)
        return np.asarray(1.0 - (np.diff(self.windup) / np.diff(self.deflection))[cell])

    def play(self, deflection: np.ndarray) -> np.ndarray:
        """Return the free travel within deflections (k,) [rad]."""
        return np.asarray(np.interp(deflection, self.deflection, self.deflection - self.windup))

    def torque(self, deflection: np.ndarray) -> np.ndarray:
        """Return the torque [N m] at deflections (k,) [rad]."""
        cell = self._locate_interval(self.deflection, deflection)
        along = deflection - self.deflection[cell]
        return np.asarray(self.carried[cell] + along / self._interval_compliance[cell])

    def compliance(self, torque: np.ndarray) -> np.ndarray:
        """Return the mean compliance [rad/(N m)] over the time of each sample (k,).

        At the edge of a play the compliance changes within a sample period.
        """
        passed = np.interp(torque, self.carried, self.deflection)
        middle = 0.5 * (passed[1:] + passed[:-1])
        before = np.concatenate([passed[:1], middle])
        after = np.concatenate([middle, passed[-1:]])
        change = self.torque(after) - self.torque(before)
        still = np.abs(change) < _MIN_TORQUE_CHANGE * np.max(np.abs(torque))
        here = self._interval_compliance[self._locate_interval(self.carried, torque)]
        return np.asarray(np.where(still, here, (after - before) / np.where(still, 1.0, change)))

    @cached_property
    def _interval_compliance(self) -> np.ndarray:
        return np.diff(self.deflection) / np.diff(self.carried)

    @staticmethod
    def _locate_interval(entries: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(entries, values, "right") - 1, 0, len(entries) - 2)


# Largest mismatch of spring and link motion [rad]; far below any encoder's noise.
_GAP_TOLERANCE = 3e-8
# Rounds without progress of the first unsettled sample,
_MAX_STALLED_ROUNDS = 16
# after which this mismatch is accepted there, as at a step of an effect [rad].
_STALLED_GAP_TOLERANCE = 1e-6
# Acceleration beyond which the solution diverges [rad/s^2].
_MAX_ACCELERATION = 1e9
# Smallest number of samples solved at a time.
_MIN_STRETCH_SAMPLES = 25
# Rounds with growing mismatch at the shortest stretch before the solve fails.
_MAX_GROWING_ROUNDS = 4
# Ratio of successive mismatches above which the springs are linearised again.
_MAX_GAP_RATIO = 0.4
# Full updates of the springs; later updates are damped, since near a bend they oscillate.
_MAX_FULL_UPDATES = 3
# Shortest window after the settling of the filter over which the initial state is fitted [s]:
# longer than most acceleration phases; extended to the decay time of vibration.
_MIN_START_WINDOW = 0.6
# Rounds of fitting the initial state.
_START_ROUNDS = 2
# Range of the tangent compliance with effects over the nominal one: beyond it a periodic error or a
# play, no spring; and largest compliance within a play.
_COMPLIANCE_RATIO_RANGE, _MAX_PLAY_COMPLIANCE_RATIO = (0.3, 10.0), 100.0

# (link motion or its first samples) -> added torque on the links, displacement of the springs'
# ends.
AddedLoad = Callable[[LinkMotion], tuple[np.ndarray, np.ndarray]]
# (link motion or its first samples) -> compliance of the springs (K, n) over the nominal one.
ComplianceRatio = Callable[[LinkMotion], np.ndarray]


class Springs:
    """Springs between motors that move as recorded and links that follow.

    `robot`: robot with known stiffness and damping. `motor`, `speed` (K, n): position and velocity
    of the motors [rad], [rad/s]. `dt` [s]. `damping` (n,): damping of the joints in place of the
    nominal one [N m s/rad]. `laws`: springs with play by joint (from 0).
    """

    def __init__(
        self,
        robot: RobotModel,
        motor: np.ndarray,
        speed: np.ndarray,
        dt: float,
        damping: np.ndarray | None = None,
        laws: Mapping[int, SpringLaw] | None = None,
    ) -> None:
        self.robot, self.motor, self.speed, self.dt = robot, motor, speed, dt
        self.damping = nominal_damping(robot) if damping is None else damping
        self.laws = laws or {}

    def play(self, links: LinkMotion) -> np.ndarray | float:
        """Return the free travel within the deflections of a motion or its first samples [rad]."""
        if not self.laws:
            return 0.0
        deflection = self.motor[: len(links.position)] - links.position
        free = np.zeros_like(deflection)
        for joint, law in self.laws.items():
            free[:, joint] = law.play(deflection[:, joint])
        return np.asarray(free)

    def with_torques(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, link_torque: np.ndarray | float = 0.0
    ) -> LinkMotion:
        """Return a motion of the links, or its first samples, with its torques."""
        torque = self.robot.spring_torque(q, v, a) + link_torque
        spring = torque - self.damping * (self.speed[: len(v)] - v)
        return LinkMotion(q, v, a, torque, spring)

    def linearise(
        self,
        links: LinkMotion,
        compliance_ratio: np.ndarray | float = 1.0,
        added_inertia: np.ndarray | float = 0.0,
        near: Vibration | None = None,
    ) -> Vibration:
        """Return the linear vibration response about a link motion.

        `compliance_ratio` (K, n): compliance over the nominal one. `added_inertia` (K, n, n): added
        to the nominal inertia [kg m^2]. `near`: response of a motion in the same postures, whose
        body terms are reused.
        """
        bodies = (
            self.robot.torque_slopes(links.position, links.velocity, links.acceleration)
            if near is None
            else near.bodies
        )
        weight, rate, inertia = bodies
        stiffness = self._spring_stiffness(links, compliance_ratio)
        own = np.eye(self.robot.n)
        mobility = None
        if near is not None and not np.any(added_inertia) and not np.any(near.added_inertia):
            mobility = near.response.mobility
        response = ElasticResponse(
            inertia + added_inertia,
            rate + self.damping * own,
            weight + stiffness[..., None] * own,
            self.dt,
            mobility,
        )
        return Vibration(
            response, stiffness, self.damping, bodies, links, compliance_ratio, added_inertia
        )

    def _spring_stiffness(
        self, links: LinkMotion, compliance_ratio: np.ndarray | float
    ) -> np.ndarray:
        """Return the stiffness of the springs (K, n) along a motion [N m/rad]."""
        nominal = self.robot.compliance(links.spring)
        compliance = nominal * np.clip(compliance_ratio, *_COMPLIANCE_RATIO_RANGE)
        for j, law in self.laws.items():
            compliance[:, j] += law.compliance(links.spring[:, j]) - nominal[:, j]
            compliance[:, j] = np.minimum(
                compliance[:, j], _MAX_PLAY_COMPLIANCE_RATIO * nominal[:, j]
            )
        return np.asarray(1.0 / compliance)

    def solve_from_slow(
        self,
        begin: LinkMotion,
        vibration: Vibration,
        added: AddedLoad | None = None,
        compliance_ratio: ComplianceRatio | None = None,
        aside: np.ndarray | None = None,
    ) -> LinkMotion | None:
        """Return the link motion that begins nearest to a slow one; None if none is found.

        `begin`: slow motion; near its ends the filter pads it. `vibration`: linear response near
        it. `added`: loads in addition to the nominal robot. `compliance_ratio`: change of the
        springs by these. `aside` (2 n,): known initial displacement and velocity relative to the
        slow motion [rad], [rad/s].
        """
        found = self._solve_nearest_start(begin, vibration, added, compliance_ratio)
        if found is None or aside is None:
            return found
        ratio = vibration.compliance_ratio if compliance_ratio is None else compliance_ratio(found)
        about = self.linearise(found, ratio, vibration.added_inertia, vibration)
        moved = found.shifted(*(part[..., 0] for part in about.response.free(aside[:, None])))
        return self.solve(moved, about, begin, added, compliance_ratio) or found

    def _solve_nearest_start(
        self,
        begin: LinkMotion,
        vibration: Vibration,
        added: AddedLoad | None,
        compliance_ratio: ComplianceRatio | None,
    ) -> LinkMotion | None:
        """Return the link motion whose initial state is nearest to a slow motion."""
        first = slow_filter(self.dt).settling
        at_first = self.solve(begin, vibration, begin, added, compliance_ratio)
        if at_first is None or len(self.motor) <= first + 2:
            return at_first
        whole = len(self.motor) * self.dt
        windows = [
            slice(first, first + max(2, round(min(length, whole) / self.dt)))
            for length in (_MIN_START_WINDOW, max(_MIN_START_WINDOW, vibration.decay_time))
        ]
        found = [at_first]
        for window in windows if windows[0] != windows[1] else windows[:1]:
            near: LinkMotion | None = at_first
            for _ in range(_START_ROUNDS):
                if near is None:
                    break
                # Springs are nonlinear: linearise about the current motion.
                ratio = (
                    vibration.compliance_ratio
                    if compliance_ratio is None
                    else compliance_ratio(near)
                )
                about = self.linearise(near, ratio, vibration.added_inertia, vibration)
                begun = about.with_nearest_start(near, begin, window)
                near = self.solve(begun, about, begin, added, compliance_ratio)
                if near is not None:
                    found.append(near)
        # A distant start or a play may converge to a vibration that the springs do not sustain.
        return min(found, key=lambda each: each.distance(begin, windows[1]))

    def solve(
        self,
        links: LinkMotion,
        vibration: Vibration,
        slow: LinkMotion,
        added: AddedLoad | None = None,
        compliance_ratio: ComplianceRatio | None = None,
    ) -> LinkMotion | None:
        """Return the link motion consistent with springs and motors; None if none is found.

        `links`: initial guess, whose first sample is kept. `vibration`: linear response near that
        motion. `slow`: motion nearby without vibration: steps are exact for it, linear for the
        difference. `added`: loads in addition to the nominal robot. `compliance_ratio`: change of
        the springs by these.
        """
        before, growing, changed, vibration = np.inf, 0, 0, vibration.copy()
        end = len(self.motor)
        reached = [0]
        settled = np.full(end, _GAP_TOLERANCE)
        torque = np.zeros_like(self.motor)
        away = links.minus(slow)
        force = vibration.force(away)
        while True:
            # Integrate from the first sample with the current springs: the result must not depend
            # on earlier linearisations.
            within = self._torque_within_steps(vibration, links.position - slow.position)
            links = slow.shifted(*vibration.response.driven(force, *away.state, within))
            # A diverged solution has no usable part.
            if not np.all(np.abs(links.acceleration) < _MAX_ACCELERATION):
                return None
            own, gaps = self._residuals_until(end, links, torque, added, settled)
            sizes = np.max(np.abs(gaps), axis=1)
            if np.all(sizes < settled[: len(sizes)]):
                return own
            first = int(np.argmax(sizes >= settled[: len(sizes)]))
            reached.append(first)
            if len(reached) > _MAX_STALLED_ROUNDS and first <= reached[-_MAX_STALLED_ROUNDS]:
                if sizes[first] > _STALLED_GAP_TOLERANCE:
                    return None
                settled[first] = _STALLED_GAP_TOLERANCE
            onward = first >= end
            # Behind a play later samples may be far off as long as more and more samples settle.
            if onward or (self.laws and first > max(reached[:-1])):
                growing = changed = 0
            if onward:
                before, end = np.inf, min(len(sizes), 2 * end)
            worst = float(np.max(sizes[:end]))
            if worst > _MAX_GAP_RATIO * before:
                # Linearise the springs again about the current motion, as far as it is solved.
                stiffness = self._updated_stiffness(
                    own, vibration, compliance_ratio, 1.0 / max(changed - _MAX_FULL_UPDATES + 1, 1)
                )
                vibration.change_springs(
                    slice(first, end), stiffness, force, links.position - slow.position
                )
                changed += 1
            if worst > before:
                # Near a bend the mismatch oscillates below the accepted one.
                growing += end - first <= _MIN_STRETCH_SAMPLES and worst > _STALLED_GAP_TOLERANCE
                if growing > _MAX_GROWING_ROUNDS:
                    return None
                # Late samples depend on all before them: solve a shorter stretch first.
                end = first + max(_MIN_STRETCH_SAMPLES, (end - first) // 4)
            before = worst
            force[:end] += self._gap_stiffness(vibration)[:end] * gaps[:end]

    def _gap_stiffness(self, vibration: Vibration) -> np.ndarray:
        """Return the torque (K, n) per mismatch that closes it [N m/rad]."""
        if not self.laws:
            return vibration.stiffness
        pulls = vibration.stiffness.copy()
        for j, law in self.laws.items():
            pulls[:, j] = law.max_stiffness
        return pulls

    def _torque_within_steps(self, vibration: Vibration, away: np.ndarray) -> np.ndarray | None:
        """Return the torque (K - 1, 2, n) at both ends of each step beyond its mean stiffness.

        For positions `away` (K, n), where springs enter or leave a play; elsewhere the change is
        small.
        """
        if not self.laws:
            return None
        half = 0.5 * np.diff(vibration.stiffness, axis=0)
        return np.stack([half * away[:-1], -half * away[1:]], axis=1)

    def _updated_stiffness(
        self,
        links: LinkMotion,
        vibration: Vibration,
        compliance_ratio: ComplianceRatio | None,
        share: float,
    ) -> np.ndarray:
        """Return a damped update of the stiffness (k, n) along the first samples [N m/rad]."""
        k = len(links.position)
        ratio = np.broadcast_to(vibration.compliance_ratio, self.motor.shape)[:k]
        stiffness = self._spring_stiffness(
            links, ratio if compliance_ratio is None else compliance_ratio(links)
        )
        return share * stiffness + (1.0 - share) * vibration.stiffness[:k]

    def _residuals_until(
        self,
        end: int,
        links: LinkMotion,
        torque: np.ndarray,
        added: AddedLoad | None,
        settled: np.ndarray,
    ) -> tuple[LinkMotion, np.ndarray]:
        """Return residuals [rad] up to `end`, of all samples once those are `settled`."""
        count = len(self.motor)
        known = min(end + _MIN_STRETCH_SAMPLES, count)
        found = self._deflection_residuals(links.head(known), torque[:known], added)
        if known == count or np.any(np.max(np.abs(found[1][:end]), axis=1) >= settled[:end]):
            return found
        return self._deflection_residuals(links, torque, added)

    def _deflection_residuals(
        self, links: LinkMotion, torque: np.ndarray, added: AddedLoad | None
    ) -> tuple[LinkMotion, np.ndarray]:
        """Return the first samples of a motion with torques, and deflection residuals.

        Residuals are in rad.

        `torque` (k, n): added torque on the links at the last call, updated in place [N m].
        """
        k = len(links.position)
        links = self.with_torques(links.position, links.velocity, links.acceleration, torque)
        displaced: np.ndarray | float = 0.0
        if added is not None:
            now, displaced = added(links)
            change = now - torque
            torque[:] = now
            links = replace(links, torque=links.torque + change, spring=links.spring + change)
        deflection = self.motor[:k] - links.position - displaced
        gaps = deflection - self.robot.windup(links.spring)
        for j, law in self.laws.items():
            # The residual is a torque here; the damper carries no torque of the free travel.
            free = law.share_of_play(deflection[:, j]) * (self.speed[:k] - links.velocity)[:, j]
            carried = law.torque(deflection[:, j])
            gaps[:, j] = carried - links.spring[:, j] - self.damping[j] * free
            gaps[:, j] /= law.max_stiffness
            links.spring[:, j] = carried
        return links, gaps


def nominal_damping(robot: RobotModel) -> np.ndarray:
    """Return the nominal damping of the joints (n,) [N m s/rad]."""
    damping = robot.recordings.nominal.joint_damping
    assert damping is not None
    return damping
