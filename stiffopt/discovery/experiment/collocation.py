"""Improve a motion that separates two explanations by direct collocation within limits."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from stiffopt.discovery.comparison.located_effect import LocatedEffect, channel_changes
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.comparison.value_name import ValueName
from stiffopt.discovery.experiment.motion import MotionLimits
from stiffopt.discovery.experiment.separation import Separation
from stiffopt.discovery.signals import JointSignals, smooth_sign
from stiffopt.dynamics.newton_euler import newton_euler
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.symbolic import Quantity, array_of
from stiffopt.transcription import (
    Guess,
    OptimalControlProblem,
    Rows,
    transcribe,
    uniform_mesh,
)

_INTERVALS_PER_SECOND = 6.0
_MAX_ITERATIONS = 60
# Relative error of the instantaneous formula of a term against the term along a run.
_FORMULA_TOLERANCE = 1e-2
_MAX_VIOLATION = 1e-3  # worst row of a design that is used, over its limit


def improve_motion(
    separation: Separation,
    run: PreparedRun,
    motion: Trajectory,
    limits: MotionLimits,
    *,
    seconds: float,
) -> Trajectory | None:
    """Improve the separation of a motion; None if that is impossible.

    Parameters
    ----------
    separation : Separation
    run : PreparedRun
        The motion, prepared.
    motion : Trajectory
        Initial guess.
    limits : MotionLimits
    seconds : float
        Time limit of the solver.

    Notes
    -----
    The rival and the friction, stiffness, gain and encoder zeros of the joints concerned are fitted
    to the first explanation on the initial motion, with the posterior of the training runs as
    prior. The squared difference over noise, integrated over the motion, is maximised with these
    held.
    """
    model = _DifferenceFormula(separation, run)
    if not model.holds(run):
        return None
    ocp = _build_problem(model, motion, limits)
    intervals = max(12, int(motion.duration * _INTERVALS_PER_SECOND))
    made = transcribe(ocp, "piecewise_linear", uniform_mesh(intervals))
    options = IpoptOptions(tol=1e-4, max_iterations=_MAX_ITERATIONS, max_seconds=seconds)
    solver = IpoptSolver(made.nlp, options)
    whole = motion.duration
    guess = Guess(
        states=lambda s: np.hstack([motion(s * whole), motion(s * whole, 1)]),
        controls=lambda s: motion(s * whole, 2),
        duration=whole,
    )
    raw = solver.solve(made.pack(guess), np.zeros(0))
    if raw.violation > _MAX_VIOLATION:
        return None
    return Trajectory.from_acceleration(*made.acceleration_polynomials(raw.x))


class _DifferenceFormula:
    """Difference of two explanations as a formula of q, v and a."""

    def __init__(self, separation: Separation, run: PreparedRun) -> None:
        comparison = separation.comparison
        self.robot: RobotModel = comparison.robot
        self.constants = comparison.constants
        n = self.robot.n
        self.effects = (separation.first.effects[0], separation.second.effects[0])
        self.q, self.v, self.a = (ca.SX.sym(name, n) for name in "qva")
        self.spring = newton_euler(self.robot.arm.tree, *self._model_coordinates())[
            self.robot.order.tolist()
        ]
        for balance in self.robot.recordings.nominal.counterbalance:
            self.spring[balance.joint] -= _counterbalance_torque(balance, self.q[balance.joint])
        inertia, coulomb, viscous = (
            ca.DM(x) for x in (self.robot.rotor_inertia, self.robot.coulomb, self.robot.viscous)
        )
        friction = coulomb * smooth_sign(self.v) + viscous * self.v
        self.drive = inertia * self.a + self.spring + friction
        noise, gain = comparison.noise, comparison.inflation
        seen = np.isin(np.arange(2 * n), comparison.rows.channels)
        sigma = np.concatenate([noise.torque, noise.deflection]) * gain
        self.weight = np.where(seen, 1.0 / sigma, 0.0)
        self.joints = sorted({e.joint for e in self.effects if e.joint is not None})
        self.usable = all(e.is_of_one_joint for e in self.effects)
        self.difference: Quantity = None
        if self.usable:
            self._fit_rival(separation, run)

    def holds(self, run: PreparedRun) -> bool:
        """True if both terms along the run equal their instantaneous formulas."""
        if not self.usable:
            return False
        for located in self.effects:
            for unit, size in zip(
                np.eye(len(located.effect.amplitudes)), located.sizes(self.constants), strict=True
            ):
                torque, deflection = self._effect_channels(located, unit * size)
                change = located.contribution(run, unit * size)
                (own,) = channel_changes([change], run, self.robot)
                for formula, term in zip((torque, deflection), own, strict=True):
                    along = self._evaluate_along(formula, run)
                    pointwise = np.zeros_like(along) if term is None else term
                    scale = float(np.sqrt(np.mean(pointwise**2)))
                    if (
                        float(np.sqrt(np.mean((along - pointwise) ** 2)))
                        > _FORMULA_TOLERANCE * scale + 1e-12
                    ):
                        return False
        return True

    def _fit_rival(self, separation: Separation, run: PreparedRun) -> None:
        """Fit the rival and nuisance values to the first explanation along the run."""
        first, second = separation.first, separation.second
        names, columns = self._free_columns(first.names)
        index = {name: i for i, name in enumerate(first.names)}
        places = [index[name] for name in names]
        rival = self.effects[1]
        count, own = len(first.names), len(rival.effect.amplitudes)
        for unit, size in zip(np.eye(own), rival.sizes(self.constants), strict=True):
            columns.append(self._weight_channels(self._effect_channels(rival, unit * size)))
        moved = first.fit.posterior.mean[places] - second.fit.posterior.mean[places]
        shift = np.concatenate([moved, -second.fit.posterior.mean[count : count + own]])
        begin = self._weight_channels(
            self._effect_channels(self.effects[0], separation.amplitudes[0])
        )
        begin += sum(float(x) * c for x, c in zip(shift, columns, strict=True))
        values = np.stack([self._evaluate_along(c, run).ravel() for c in (begin, *columns)], axis=1)
        # Scale to the number of recorded rows: the noise is that of one recorded sample.
        values *= np.sqrt(run.signals.dt / separation.comparison.runs[0].signals.dt)
        kept = [*places, *range(count, count + own)]
        spread = second.fit.posterior.covariance[np.ix_(kept, kept)]
        inner = values[:, 1:].T @ values[:, 1:] + np.linalg.inv(spread)
        theta = np.linalg.solve(inner, values[:, 1:].T @ values[:, 0])
        self.difference = begin - sum(float(t) * c for t, c in zip(theta, columns, strict=True))

    def _free_columns(self, names: list[ValueName]) -> tuple[list[ValueName], list[Quantity]]:
        """Return the nominal values of the joints concerned that have instantaneous formulas."""
        n, zero = self.robot.n, ca.SX.zeros(self.robot.n)
        found: dict[ValueName, Quantity] = {}
        for j in self.joints:
            unit = ca.SX.zeros(n)
            unit[j] = 1.0
            dry, wet = float(self.robot.coulomb[j]), float(self.robot.viscous[j])
            for kind, channels in (
                ("coulomb", (unit * (dry * smooth_sign(self.v[j])), zero)),
                ("viscous", (unit * (wet * self.v[j]), zero)),
                ("torque_constant", (unit * self.drive[j], zero)),
                ("stiffness", (zero, unit * self.constants.joints[j].windup(self.spring[j]))),
                ("encoder_zero", (zero, unit)),
            ):
                found[ValueName(kind, j)] = self._weight_channels(channels)
        kept = [name for name in found if name in names]
        return kept, [found[name] for name in kept]

    def _effect_channels(
        self, located: LocatedEffect, amplitudes: np.ndarray
    ) -> tuple[Quantity, Quantity]:
        n, j = self.robot.n, located.joint
        assert j is not None
        constants = self.constants.joints[j]
        signals = JointSignals(
            time=0.0 * self.q[j],
            dt=1.0,
            session_time=0.0 * self.q[j],
            temperature_rise=0.0 * self.q[j],
            motor_position=self.q[j],
            motor_velocity=self.v[j],
            motor_acceleration=self.a[j],
            motor_direction=smooth_sign(self.v[j]),
            link_position=self.q[j],
            link_velocity=self.v[j],
            link_acceleration=self.a[j],
            transmitted_torque=self.spring[j],
            spring_torque=self.spring[j],
            windup=constants.windup(self.spring[j]),
            drive_torque=self.drive[j],
            # A third derivative: `holds` rejects terms that need it.
            drive_torque_rate=0.0 * self.q[j],
            previous_position=self.q[j - 1] if j else 0.0 * self.q[j],
            previous_velocity=self.v[j - 1] if j else 0.0 * self.q[j],
            previous_acceleration=self.a[j - 1] if j else 0.0 * self.q[j],
            constants=constants,
        )
        term = located.effect.term(signals, [float(x) for x in amplitudes], located.shapes)
        torque, deflection = ca.SX.zeros(n), ca.SX.zeros(n)
        torque[j] = term.drive_torque + term.link_torque
        if j:
            torque[j - 1] += term.previous_torque
        slope = constants.compliance(self.spring[j])
        deflection[j] = term.deflection + term.reading + slope * term.link_torque
        return torque, deflection

    def _weight_channels(self, channels: tuple[Quantity, Quantity]) -> Quantity:
        return ca.vertcat(*channels) * ca.DM(self.weight)

    def _evaluate_along(self, formula: Quantity, run: PreparedRun) -> np.ndarray:
        s = run.signals
        function = ca.Function("along", [self.q, self.v, self.a], [ca.densify(formula)])
        points = (s.motor_position.T, s.motor_velocity.T, s.motor_acceleration.T)
        return np.asarray(array_of(function.map(len(run.time))(*points)).T)

    def _model_coordinates(self) -> tuple[Any, Any, Any]:
        full = []
        for own in (self.q, self.v, self.a):
            values = ca.SX.zeros(self.robot.n)
            values[self.robot.order.tolist()] = own
            full.append(values)
        return full[0], full[1], full[2]


def _counterbalance_torque(balance: Any, angle: Quantity) -> Quantity:
    if balance.angle is None:
        return balance.at(angle)
    table = ca.interpolant("balance", "linear", [list(balance.angle)], list(balance.torque))
    return table(angle)


def _two_sided_rows(name: str, labels: list[str], most: np.ndarray, unit: str) -> Rows:
    """Return rows of a two-sided limit that also holds between the nodes."""
    return Rows.make(name, labels, -most, most, most, unit, midpoints=True)


def _build_problem(
    model: _DifferenceFormula, motion: Trajectory, limits: MotionLimits
) -> OptimalControlProblem:
    n = model.robot.n
    x, u = ca.vertcat(model.q, model.v), model.a
    z, p = ca.SX.sym("z", 0), ca.SX.sym("p", 0)
    names = [f"joint {j + 1}" for j in range(n)]
    integrand = ca.sumsqr(model.difference)
    total, length = ca.SX.sym("I", 1), ca.SX.sym("T")
    first, last = ca.SX.sym("x0", 2 * n), ca.SX.sym("xf", 2 * n)
    lower = np.concatenate([limits.lower, -limits.velocity])
    upper = np.concatenate([limits.upper, limits.velocity])
    start = np.concatenate([motion(0.0), np.zeros(n)])
    free = np.concatenate([limits.lower, np.zeros(n)])
    end = np.concatenate([limits.upper, np.zeros(n)])
    times = np.linspace(0.0, motion.duration, 200)
    function = ca.Function("size", [model.q, model.v, model.a], [integrand])
    along = array_of(function.map(len(times))(*(motion(times, k).T for k in range(3))))
    return OptimalControlProblem(
        name="next experiment",
        states=(*(f"{j} position" for j in names), *(f"{j} velocity" for j in names)),
        controls=tuple(f"{j} acceleration" for j in names),
        dynamics=ca.Function("dynamics", [x, u, p], [ca.vertcat(model.v, u)]),
        stage=ca.Function("stage", [x, u, z, p], [integrand, ca.vertcat(model.drive, model.v)]),
        objective=ca.Function("objective", [total, length, z, first, last, p], [-total]),
        duration=(motion.duration, motion.duration),
        path_rows=(
            _two_sided_rows("torque", names, limits.torque, "N m"),
            _two_sided_rows("velocity", names, limits.velocity, "rad/s"),
        ),
        state_lower=lower,
        state_upper=upper,
        control_lower=-limits.acceleration,
        control_upper=limits.acceleration,
        initial_lower=start,
        initial_upper=start,
        final_lower=free,
        final_upper=end,
        chains=tuple((j, n + j, j) for j in range(n)),
        state_scale=np.maximum(np.abs(lower), np.abs(upper)),
        control_scale=limits.acceleration,
        objective_scale=max(float(np.mean(along)) * motion.duration, 1e-12),
    )
