"""Triangular factors of small matrices in symbols."""

from __future__ import annotations

import casadi as ca


def factorize(matrix: ca.SX, *, symmetric: bool) -> list[list[ca.SX]]:
    """Return triangular factors of a matrix (n, n) in one, which share their diagonal.

    Without pivots: masses outweigh what torques by accelerations add.
    """
    n = matrix.shape[0]
    factor: list[list[ca.SX]] = [[ca.SX(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i):
            for row, column in ((i, j), (j, i)):
                rest = matrix[row, column]
                rest -= sum(factor[row][k] * factor[k][column] for k in range(j))
                factor[row][column] = rest / factor[j][j]
                if symmetric:
                    factor[j][i] = factor[i][j]
                    break
        rest = matrix[i, i] - sum(factor[i][k] * factor[k][i] for k in range(i))
        factor[i][i] = ca.sqrt(rest)
    return factor


def solve(factor: list[list[ca.SX]], right: ca.SX) -> ca.SX:
    """Solve with the factors of a matrix; `right` (n, m)."""
    n = len(factor)
    forward: list[ca.SX] = []
    for i in range(n):
        rest = right[i, :] - sum(factor[i][k] * forward[k] for k in range(i))
        forward.append(rest / factor[i][i])
    found: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        rest = forward[i] - sum(factor[i][k] * found[k] for k in range(i + 1, n))
        found[i] = rest / factor[i][i]
    return ca.vertcat(*found)
