"""Force at the tool that changes along the motion: a person who guides the arm, a hose, a touch.

It predicts nothing of other runs and is no effect of the catalogue. But three numbers an instant
explain the torques of all joints, where anything else needs as many numbers as there are joints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.search.search import SearchResult

# Least residual over noise that is tested, and largest share of its square, per degree of freedom,
# that forces at the tool may leave.
_MIN_RATIO, _MAX_LEFT_SHARE = 3.0, 0.05
# Joints with torque beyond the three that any force explains.
_MIN_SPARE_JOINTS = 1
# Percentile of the forces that is stated as their size.
_SIZE_PERCENTILE = 95.0


@dataclass(frozen=True, kw_only=True)
class ToolForce:
    """Forces at the tool that explain a residual."""

    explained: float  # share of the squared residual of the torques
    size: float  # force exceeded in a twentieth of the time [N]
    # Length of the mean force in the base frame over the root mean square, 0 to 1.
    steadiness: float


def explain_by_tool_force(
    result: SearchResult, unexplained: Unexplained | None
) -> Unexplained | None:
    """Return an unexplained residual with the forces at the tool that explain it, if any do."""
    if unexplained is None or unexplained.ratio < _MIN_RATIO:
        return unexplained
    found = [_fit_tool_force(result, rows) for rows in (result.fit.residual, result.target)]
    best = max((each for each in found if each), key=lambda each: each.explained, default=None)
    return replace(unexplained, tool_force=best)


def _fit_tool_force(result: SearchResult, residual: np.ndarray) -> ToolForce | None:
    """Fit a force at every instant; None where too little of the residual is explained by it."""
    comparison = result.comparison
    rows, n = comparison.rows, comparison.robot.n
    forces, before, after, spare = [], 0.0, 0.0, 0
    for index, run in enumerate(comparison.runs):
        own = (rows.run == index) & (rows.channel < n)
        instants, at = np.unique(rows.sample[own], return_inverse=True)
        left = np.zeros((len(instants), n))
        seen = np.zeros(left.shape, dtype=bool)
        left[at, rows.channel[own]] = residual[own]
        seen[at, rows.channel[own]] = True
        size = run.low_pass.noise_gain * rows.noise.torque
        lever = -run.signals.tool_jacobian[instants] / size
        for torque, columns, known in zip(left, lever, seen, strict=True):
            rank = int(np.linalg.matrix_rank(columns[:, known]))
            if known.sum() < rank + _MIN_SPARE_JOINTS:
                continue
            force, *_ = np.linalg.lstsq(columns[:, known].T, torque[known], rcond=1e-3)
            rest = torque[known] - force @ columns[:, known]
            forces.append(force)
            before += float(torque[known] @ torque[known]) * (known.sum() - rank) / known.sum()
            after += float(rest @ rest)
            spare += int(known.sum()) - rank
    if not spare or before < _MIN_RATIO**2 * spare or after > _MAX_LEFT_SHARE * before:
        return None
    every = np.array(forces)
    rms = float(np.sqrt(np.mean(np.sum(every**2, axis=1))))
    return ToolForce(
        explained=1.0 - after / before,
        size=float(np.percentile(np.linalg.norm(every, axis=1), _SIZE_PERCENTILE)),
        steadiness=float(np.linalg.norm(every.mean(axis=0))) / max(rms, 1e-12),
    )
