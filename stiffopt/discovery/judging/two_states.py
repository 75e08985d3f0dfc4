"""Assign the instants of runs to one of two states by Viterbi's algorithm, in correlated noise.

Residuals in either state are noise whose size and correlation are estimated with the states, in
turn. A change of state costs the log of the number of instants: the code length of its place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Alternations of states and noise.
_MAX_NOISE_ROUNDS = 4
# Least variance of a residual: one that is zero has a likelihood too.
MIN_VARIANCE = 1e-30


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants (m,) of several runs, one run after another, at which channels (n,) are compared."""

    run: np.ndarray  # (m,) index of the run
    time: np.ndarray  # (m,) [s]
    used: np.ndarray  # (m, n) True where a channel is compared

    def mean_squares(self, values: np.ndarray) -> np.ndarray:
        """Return the mean squares (n,) of the used values (m, n)."""
        total = np.sum(values**2, axis=0, where=self.used)
        return np.asarray(total / np.maximum(self.used.sum(axis=0), 1))

    def independent(self, left: np.ndarray) -> np.ndarray:
        """Return the numbers (n,) of independent values among residuals (m, n), 0 where not used.

        The used ones over their integrated autocorrelation (Sokal 1997).
        """
        return np.asarray(self.used.sum(axis=0) / self.correlation(left))

    def correlation(self, left: np.ndarray) -> np.ndarray:
        """Return the integrated autocorrelation (n,) of residuals (m, n), 0 where not used."""
        found = np.ones(left.shape[1])
        for j, column in enumerate(left.T):
            square = float(column @ column)
            for lag in range(1, len(column) // 2 if square else 0):
                same = self.run[lag:] == self.run[:-lag]
                value = float(np.sum(column[lag:] * column[:-lag], where=same)) / square
                if value <= 0.0:
                    break
                found[j] += 2.0 * value
        return found

    def switch_price(self, second: np.ndarray) -> float:
        """Return the log number of places of all changes, and of the first state of each run."""
        same = self.run[1:] == self.run[:-1]
        changes = int(np.sum((second[1:] != second[:-1]) & same))
        return float((changes + len(np.unique(self.run))) * np.log(len(second)))

    def assign_states(
        self, first: np.ndarray, second: np.ndarray, *, correlated: bool = True
    ) -> tuple[np.ndarray, float]:
        """Return 1 at the instants (m,) of the second state, else 0, and their log likelihood.

        `first`, `second` (m, n): residuals in either state. `correlated`: count independent
        residuals; else all.
        """
        gain = np.where(self.used, first**2 - second**2, 0.0)
        states, likelihood = gain.sum(axis=1) > 0.0, -np.inf
        for _ in range(_MAX_NOISE_ROUNDS):
            left = np.where(states[:, None], second, first) * self.used
            variance = np.maximum(self.mean_squares(left), MIN_VARIANCE)
            samples = self.correlation(left) if correlated else np.ones(left.shape[1])
            before = states
            states = self._viterbi(0.5 * np.sum(gain / (variance * samples), axis=1))
            likelihood = -0.5 * float(self.used.sum(axis=0) @ np.log(variance))
            if np.array_equal(before, states):
                break
        return states.astype(int), likelihood - self.switch_price(states)

    def _viterbi(self, gain: np.ndarray) -> np.ndarray:
        """Return True at the instants (m,) of the second state, of which `gain` (m,) is ahead."""
        price = np.log(len(gain))
        starts = np.diff(self.run, prepend=self.run[0] - 1) != 0
        # Whether the best past of each state is the other one; the second state's advantage.
        switched = np.zeros((len(gain), 2), dtype=bool)
        advantage = np.empty(len(gain))
        ahead = 0.0
        for k, value in enumerate(gain):
            ahead = 0.0 if starts[k] else ahead
            switched[k] = ahead > price, ahead < -price
            ahead = min(max(ahead, -price), price) + value
            advantage[k] = ahead
        states, state = np.zeros(len(gain), dtype=bool), False
        for k in range(len(gain) - 1, -1, -1):
            if k + 1 == len(gain) or starts[k + 1]:
                state = bool(advantage[k] > 0.0)
            states[k] = state
            state ^= bool(switched[k, int(state)])
        return states


def intervals_of(time: np.ndarray, states: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Return begin and end of the intervals of times (m,) in which states (m,) are 1."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], states, [0]])))
    return tuple(
        (float(time[first]), float(time[last - 1]))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    )
