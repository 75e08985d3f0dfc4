"""Transcribed problem: the NLP, and conversion between its vector and motions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy
from numpy.polynomial import polynomial

from stiffopt.errors import ProblemError
from stiffopt.symbolic import array_of
from stiffopt.transcription import grid
from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import Block, Nlp, Places
from stiffopt.transcription.ocp import Guess, OptimalControlProblem
from stiffopt.transcription.scheme import Intervals, Scheme


@dataclass(frozen=True, kw_only=True)
class Unpacked:
    """A motion read from an NLP vector, in the problem's units."""

    times: np.ndarray  # (NX,) times of the states [s]
    states: np.ndarray  # (NX, nx)
    controls: np.ndarray  # (NU, nu)
    statics: np.ndarray  # (nz,)
    duration: float  # [s]
    phase_durations: np.ndarray  # (phases,) [s]
    breaks: np.ndarray  # (K + 1,) borders of the intervals [s]
    integrals: np.ndarray  # (k,)
    objective: float


@dataclass(frozen=True, kw_only=True)
class Transcription:
    """NLP of an optimal-control problem on a mesh; made by `transcribe`."""

    ocp: OptimalControlProblem
    scheme: Scheme
    mesh: Mesh  # interval fractions of each phase
    nlp: Nlp
    # Blocks of these variables in the NLP vector; `durations` is None when fixed.
    states: Block
    controls: Block
    statics: Block
    durations: Block | None
    # Splines whose coefficients are the variables, and the block of these. The blocks of states and
    # controls then hold their bounds and scales only.
    splines: ChainSplines | None = None
    coefficients: Block | None = None
    # Blocks of the path rows among the NLP's rows, and their indices in the stage's path rows.
    path_blocks: tuple[tuple[Block, np.ndarray], ...]
    outputs: ca.Function
    # Hash, equal for problems whose programmes differ in bounds and `Nlp.numbers` only.
    structure: str

    @property
    def intervals(self) -> Intervals:
        """Intervals in order of time."""
        return Intervals.of(self.mesh)

    def phase_durations(self, x: np.ndarray) -> np.ndarray:
        """Duration of each phase [s] (phases,)."""
        if self.durations is None:
            return np.array([self.ocp.duration[0]])
        durations: np.ndarray = self.durations.take(x)[0]
        return durations

    def steps(self, x: np.ndarray) -> np.ndarray:
        """Duration of each interval [s] (K,)."""
        return np.asarray(self.intervals.shares @ self.phase_durations(x))

    def breaks(self, x: np.ndarray) -> np.ndarray:
        """Borders of the intervals [s] (K + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.steps(x))])

    def times_of(self, places: Places, x: np.ndarray) -> np.ndarray:
        """Times (k,) [s] of places in the motion of an NLP vector."""
        return _place_times(places, self.phase_durations(x))

    def pack(self, guess: Guess) -> np.ndarray:
        """Return the NLP vector of a guess, moved into the bounds of the variables."""
        phases = self.ocp.phases
        shares = np.asarray(guess.phase_fractions, dtype=float)
        shares = shares / shares.sum() if len(shares) == phases else np.full(phases, 1.0 / phases)
        states = self.scheme.state_places(self.intervals)
        controls = self.scheme.control_places(self.intervals)
        own = _sample_guess(guess.states, self.states, states, shares)
        driven = _sample_guess(guess.controls, self.controls, controls, shares)
        parts = {
            self.states.rows.name: own,
            self.controls.rows.name: driven,
            self.statics.rows.name: np.broadcast_to(guess.statics, (1, len(self.ocp.statics))),
        }
        if self.durations is not None:
            parts[self.durations.rows.name] = (guess.duration * shares)[None, :]
        if self.splines is not None and self.coefficients is not None:
            durations = np.array([self.ocp.duration[0]])
            if self.durations is not None:
                durations = guess.duration * shares
            parts[self.coefficients.rows.name] = self._fit_coefficients(
                np.hstack([own, driven]), durations
            )
        x = np.zeros(self.nlp.variables.size)
        for block in self.nlp.variables.items:
            values = np.asarray(parts[block.rows.name], dtype=float) / block.rows.scale
            x[block.offset : block.offset + block.size] = values.ravel()
        if not np.all(np.isfinite(x)):
            entry = self.nlp.variables.entry(int(np.flatnonzero(~np.isfinite(x))[0]))
            raise ProblemError(
                f"initial guess: {entry} is not a finite number. Give finite values over the "
                "whole motion."
            )
        return np.clip(x, self.nlp.lower_x, self.nlp.upper_x)

    def unpack(self, x: np.ndarray, parameters: np.ndarray | None = None) -> Unpacked:
        """Read the motion of an NLP vector; `parameters` default to those of the problem."""
        x = np.asarray(x, dtype=float).ravel()
        p = self.ocp.parameters if parameters is None else parameters
        durations = self.phase_durations(x)
        integrals, objective = self.outputs(x, self.nlp.parameters(p))
        return Unpacked(
            times=_place_times(self.scheme.state_places(self.intervals), durations),
            states=self.node_states(x),
            controls=self._node_controls(x),
            statics=self.statics.take(x)[0],
            duration=float(durations.sum()),
            phase_durations=durations,
            breaks=self.breaks(x),
            integrals=array_of(integrals).ravel(),
            objective=float(objective),
        )

    def control_polynomials(self, x: np.ndarray) -> np.ndarray:
        """Power coefficients (K, m, nu) of the controls in local time [s], lowest power first."""
        steps = self.steps(x)
        values = self._node_controls(x)[self.scheme.control_columns(len(steps))]
        coefficients = np.einsum(
            "ij,kjn->kin", grid.power_from_values(self.scheme.control_nodes), values
        )
        powers = steps[:, None] ** np.arange(coefficients.shape[1])
        result: np.ndarray = coefficients / powers[:, :, None]
        return result

    def acceleration_polynomials(
        self, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the motion as piecewise-polynomial accelerations, from its start.

        Breaks (K + 1,) [s], coefficients (K, degree + 1, n) in the time since the interval's start,
        lowest power first, for n `ocp.chains`; position and velocity (n,) at the start.
        """
        q, v, *higher, u = (list(index) for index in zip(*self.ocp.chains, strict=True))
        states, controls = self.node_states(x), self.control_polynomials(x)[:, :, u]
        starts = states[self.scheme.state_columns(len(controls))[:, 0]]
        coefficients = _integrate_polynomials([starts[:, own] for own in higher], controls)
        return self.breaks(x), coefficients, states[0, q], states[0, v]

    def guess_from(self, x: np.ndarray) -> Guess:
        """Return the motion as a guess for another mesh or scheme.

        States are the integrals of the controls, which follow their interpolating polynomial in
        each interval.
        """
        x = np.asarray(x, dtype=float).ravel()
        durations = self.phase_durations(x)
        total = float(durations.sum())
        breaks, controls = self.breaks(x), self.control_polynomials(x)
        states = self._state_polynomials(x, self.steps(x), controls)
        return Guess(
            states=lambda s: _evaluate_pieces(breaks, states, np.asarray(s) * total),
            controls=lambda s: _evaluate_pieces(breaks, controls, np.asarray(s) * total),
            statics=self.statics.take(x)[0],
            duration=total,
            phase_fractions=durations / total,
        )

    def motion_basis(self) -> scipy.sparse.csr_matrix | None:
        """Matrix (variables, k) from spline coefficients to the motions that obey all equations.

        None where the equations are nonlinear, as with a free duration, where coefficients are the
        variables already, or where there are static variables.
        """
        splines = self.scheme.motion_splines(self.ocp, self.mesh)
        if splines is None or self.durations is not None or self.statics.size:
            return None
        places = self.scheme.state_places(self.intervals)
        values = splines.matrix(places, np.array([self.ocp.duration[0]]))
        # Rows are (states, controls) point by point; the variables have all states first.
        order = np.arange(values.shape[0]).reshape(len(places), -1)
        states, controls = np.split(order, [len(self.ocp.states)], axis=1)
        scales = np.concatenate([self.states.scales, self.controls.scales])
        variables = values[np.append(states, controls)]
        return (scipy.sparse.diags(1.0 / scales) @ variables).tocsr()

    def node_states(self, x: np.ndarray) -> np.ndarray:
        """States (NX, nx) at the nodes."""
        if self.splines is None:
            return self.states.take(x)
        return self._spline_values(x)[:, : len(self.ocp.states)]

    def _node_controls(self, x: np.ndarray) -> np.ndarray:
        """Controls (NU, nu) at their nodes."""
        if self.splines is None:
            return self.controls.take(x)
        return self._spline_values(x)[:, len(self.ocp.states) :]

    def _spline_values(self, x: np.ndarray) -> np.ndarray:
        assert self.splines is not None
        assert self.coefficients is not None
        places = self.scheme.state_places(self.intervals)
        own = self.coefficients.take(x).ravel()
        return self.splines.evaluate(places, own, self.phase_durations(x))

    def _fit_coefficients(self, values: np.ndarray, durations: np.ndarray) -> np.ndarray:
        """Fit spline coefficients (k, n) to states and controls at the nodes."""
        assert self.splines is not None
        places = self.scheme.state_places(self.intervals)
        scales = np.concatenate([self.ocp.state_scale, self.ocp.control_scale])
        found = self.splines.fit(places, values, scales, durations)
        return found.reshape(-1, len(self.ocp.chains))

    def _state_polynomials(
        self, x: np.ndarray, steps: np.ndarray, controls: np.ndarray
    ) -> np.ndarray:
        starts = self.node_states(x)[self.scheme.state_columns(len(steps))[:, 0]]
        degree = controls.shape[1] + len(self.ocp.chains[0]) - 1
        result = np.zeros((len(steps), degree, starts.shape[1]))
        for *own, control in self.ocp.chains:
            for k, state in enumerate(own):
                integrated = _integrate_polynomials(
                    [starts[:, [i]] for i in own[k:]], controls[:, :, [control]]
                )
                result[:, : integrated.shape[1], state] = integrated[:, :, 0]
        return result


def _integrate_polynomials(starts: list[np.ndarray], coefficients: np.ndarray) -> np.ndarray:
    """Integrate polynomials (K, m, n) as often as there are starts (K, n), outermost first."""
    if not starts:
        return coefficients
    power = np.arange(coefficients.shape[1], dtype=float)
    divisor = np.prod([power + i for i in range(1, len(starts) + 1)], axis=0)
    first = [start / math.factorial(k) for k, start in enumerate(starts)]
    return np.concatenate([np.stack(first, axis=1), coefficients / divisor[:, None]], axis=1)


def _sample_guess(
    function: Callable[[np.ndarray], np.ndarray], block: Block, places: Places, shares: np.ndarray
) -> np.ndarray:
    values = np.asarray(function(_place_times(places, shares)), dtype=float)
    expected = (len(places), len(block.rows))
    if values.shape != expected:
        raise ProblemError(
            f"initial guess: the {block.rows.name} callable returned shape {values.shape} for "
            f"{len(places)} points; it must be {expected}."
        )
    return values


def _place_times(places: Places, durations: np.ndarray) -> np.ndarray:
    starts = np.cumsum(durations) - durations
    times: np.ndarray = starts[places.phase] + durations[places.phase] * places.fraction
    return times


def _evaluate_pieces(breaks: np.ndarray, coefficients: np.ndarray, times: np.ndarray) -> np.ndarray:
    times = np.atleast_1d(times)
    # A border belongs to the interval before it, which with Radau has a point there.
    early = times - 1e-12 * breaks[-1]
    index = np.clip(np.searchsorted(breaks, early) - 1, 0, len(coefficients) - 1)
    local = (times - breaks[index])[:, None]
    picked = np.moveaxis(coefficients[index], 1, 0)
    values: np.ndarray = polynomial.polyval(local, picked, tensor=False)
    return values
