"""Identity of programmes: problems that differ in bounds and numbers only share one graph."""

from __future__ import annotations

import hashlib
from dataclasses import fields, replace

import numpy as np

from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.node_derivatives import NumberedStage
from stiffopt.transcription.ocp import OptimalControlProblem, Rows, Waypoint
from stiffopt.transcription.scheme import Scheme

# Fields that `structure_of` hashes, or that are compared block by block.
_GRAPH_FIELDS = (
    "name", "stage", "intermediate", "objective", "integral_function",
    "path_rows", "integral_rows", "start", "vias", "end",
)  # fmt: skip


def structure_of(
    ocp: OptimalControlProblem, stage: NumberedStage, scheme: Scheme, mesh: Mesh
) -> str:
    """Hash everything that the graph of a programme depends on.

    Excluded: bounds (only their existence counts), scales (those of the first programme stay), a
    fixed duration and the numbers of the stage, among them payload, tool, force and drivetrain.
    """
    functions = [ocp.objective]
    functions += [] if ocp.integral_function is None else [ocp.integral_function]
    points = [ocp.start, *ocp.vias, ocp.end]
    functions += [point.function for point in points if point is not None]
    blocks = [*ocp.path_rows, *ocp.integral_rows, *(r for w in points if w for r in w.rows)]
    facts: list[object] = [
        stage.formula,
        (scheme.name, scheme.state_nodes.tolist(), scheme.control_nodes.tolist()),
        [share.tolist() for share in mesh],
        (ocp.states, ocp.controls, ocp.statics, ocp.chains),
        [point is None for point in points],
        ocp.fixed_duration,
        len(ocp.parameters),
        [(rows.name, rows.labels, rows.bounded.tolist()) for rows in blocks],
        [_are_finite(ocp.control_rate_lower), _are_finite(ocp.control_rate_upper)],
        [_are_finite(ocp.state_lower), _are_finite(ocp.state_upper)],
        [_are_finite(ocp.control_lower), _are_finite(ocp.control_upper)],
        *(function.serialize() for function in functions),
    ]
    return hashlib.sha256("\0".join(map(repr, facts)).encode()).hexdigest()


def scaled_like(ocp: OptimalControlProblem, first: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem with the scales of another one, which are part of the graph."""
    return replace(
        ocp,
        state_scale=first.state_scale,
        control_scale=first.control_scale,
        static_scale=first.static_scale,
        path_rows=_with_scales_of(ocp.path_rows, first.path_rows),
        integral_rows=_with_scales_of(ocp.integral_rows, first.integral_rows),
        start=_scale_waypoint(ocp.start, first.start),
        end=_scale_waypoint(ocp.end, first.end),
        vias=tuple(
            replace(own, rows=_with_scales_of(own.rows, other.rows))
            for own, other in zip(ocp.vias, first.vias, strict=True)
        ),
    )


def same_bounds(one: OptimalControlProblem, other: OptimalControlProblem) -> bool:
    """True if two problems of one structure have the same bounds, scales and duration."""
    return _bound_values(one) == _bound_values(other)


def _bound_values(ocp: OptimalControlProblem) -> list[object]:
    points = [ocp.start, *ocp.vias, ocp.end]
    blocks = [*ocp.path_rows, *ocp.integral_rows, *(r for w in points if w for r in w.rows)]
    facts: list[object] = [
        getattr(ocp, each.name) for each in fields(ocp) if each.name not in _GRAPH_FIELDS
    ]
    facts += [each for rows in blocks for each in (rows.lower, rows.upper, rows.scale)]
    return [each.tobytes() if isinstance(each, np.ndarray) else each for each in facts]


def _scale_waypoint(own: Waypoint | None, first: Waypoint | None) -> Waypoint | None:
    if own is None or first is None:
        return own
    return replace(own, rows=_with_scales_of(own.rows, first.rows))


def _with_scales_of(own: tuple[Rows, ...], first: tuple[Rows, ...]) -> tuple[Rows, ...]:
    return tuple(replace(a, scale=b.scale) for a, b in zip(own, first, strict=True))


def _are_finite(bounds: np.ndarray | None) -> list[bool] | None:
    return None if bounds is None else [bool(each) for each in np.isfinite(bounds)]
