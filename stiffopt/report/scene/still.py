"""Still picture of the arm for a page, needed without WebGL, without scripts and in print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.svg import BLUE, GREY, PALE, VERMILLION, WIDTH, figure_style
from stiffopt.report.common.text import si
from stiffopt.report.scene.document import edges_around, scene_document, scene_json
from stiffopt.report.scene.poses import Poses
from stiffopt.report.solve.space_figures import exaggeration
from stiffopt.robot.batched_kinematics import frame_positions
from stiffopt.robot.body_tree import BodyTree, joint_radii, link_capsules
from stiffopt.robot.cell import Cell
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.robot import Robot

_HEIGHT_INCH = 4.6
# Elevation of the viewpoint above the horizon [rad].
_VIEW_ELEVATION = 0.4


@figure_style()
def still_figure(
    tree: BodyTree,
    tool: LinkFrame,
    motions: Sequence[Poses],
    part: str,
    factor: float,
    cell: Cell | None = None,
) -> Figure:
    """Draw the arm at the largest deflection, bent and planned, with start, end and tool paths.

    The picture has no text, so that it fits small screens; `still_caption` returns the caption.
    `motions`: the first is drawn as an arm, others as tool paths. `part`: part of the deflection;
    "" where the motion has none. `factor`: magnification of the deflection. `cell`: cell whose box
    edges are drawn.
    """
    poses, at = motions[0], largest(motions[0], part)
    bent = poses.position - factor * poses.bend[part] if part else poses.position
    share = poses.share[part][at] if part else np.zeros(tree.n)
    view = _view_axes(tree, tool, poses.position)
    paths: list[tuple[np.ndarray, str, Any]] = [(poses.position, BLUE, "-")]
    if part:
        paths.append((bent, VERMILLION, "-"))
    paths += [(other.position, GREY, (0, (4, 2))) for other in motions[1:]]
    figure = Figure(figsize=(WIDTH, _HEIGHT_INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    ends = poses.position[[0, -1]]
    flats = [frame_positions(tree, tool, each) @ view.T for each, _, _ in paths]
    seen = np.vstack([flat[:, :2] for flat in flats])
    scale = _fit_view(axes, tree, tool, view, np.vstack([ends, bent[at : at + 1]]), seen)
    for edge in edges_around(cell):
        axes.plot(*(edge @ view.T)[:, :2].T, color=GREY, linewidth=0.8, zorder=0.5)
    for q in ends:
        _draw_arm(axes, tree, tool, view, q, scale, PALE, None, 0.55)
    if part:
        _draw_arm(axes, tree, tool, view, poses.position[at], scale, BLUE, None, 0.25)
    _draw_arm(axes, tree, tool, view, bent[at], scale, "#c3c9d1", share, 1.0)
    for flat, (_, colour, dash) in zip(flats, paths, strict=True):
        axes.plot(*flat[:, :2].T, color=colour, linestyle=dash, zorder=20)
    flat = frame_positions(tree, tool, bent[at : at + 1]) @ view.T
    axes.plot(*flat[:, :2].T, "o", color=VERMILLION, markersize=6, zorder=21)
    return figure


def largest(poses: Poses, part: str) -> int:
    """Return the index of the largest deflection, or the middle where there is none."""
    return int(np.argmax(poses.deflection[part])) if part else len(poses.time) // 2


def still_caption(motions: Mapping[str, Poses], part: str, factor: float) -> str:
    """Return the caption of the still picture."""
    (_, poses), *others = motions.items()
    at = largest(poses, part)
    dashed = "".join(f"; dashed: {name}" for name, _ in others)
    if not part:
        return f"The arm at {poses.time[at]:.3f} s; start and end are pale. Blue: the tool{dashed}."
    shares = ", ".join(
        f"J{number} {round(100 * each) or 0} %".replace("-", "−")
        for number, each in enumerate(poses.share[part][at], start=1)
    )
    size = si(float(poses.deflection[part][at]), "m", 3)
    return (
        f"The arm at {poses.time[at]:.3f} s, where its {part} deflection is largest, {size};"
        f" start and end are pale. Blue: planned; red: {part} deflection × {factor:g}{dashed}. "
        f"Joints are coloured by their share of the deflection: {shares}."
    )


def _view_axes(tree: BodyTree, tool: LinkFrame, positions: np.ndarray) -> np.ndarray:
    """Return the view's axes as rows (right, up, towards the viewer), oblique to the motion."""
    points = frame_positions(tree, tool, positions)
    forward = points.mean(axis=0) - np.array([0.0, 0.0, 0.0])
    heading = np.arctan2(forward[1], forward[0]) if np.hypot(*forward[:2]) > 1e-6 else 0.0
    turn = heading - 0.35 * np.pi
    back = np.array([np.cos(turn), np.sin(turn), 0.0]) * np.cos(_VIEW_ELEVATION)
    back[2] = np.sin(_VIEW_ELEVATION)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def _capsules_at_pose(
    tree: BodyTree, tool: LinkFrame, q: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Return ends and radius of the arm's capsules in the base frame."""
    rods = []
    for rod in link_capsules(tree, tool):
        begin, end = (_point_at_pose(tree, rod.joint, each, q) for each in (rod.begin, rod.end))
        rods.append((begin, end, rod.radius))
    return rods


def _point_at_pose(tree: BodyTree, joint: int, point: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return a point of a joint's body, or of the base, in the base frame."""
    if joint == 0:
        return point
    return np.asarray(frame_positions(tree, LinkFrame(joint, point, np.eye(3)), q[None])[0])


def _fit_view(
    axes: Axes,
    tree: BodyTree,
    tool: LinkFrame,
    view: np.ndarray,
    positions: np.ndarray,
    seen: np.ndarray,
) -> float:
    """Set the axes' limits to hold all poses and points (K, 2); return printed points per metre."""
    ends = [
        (view @ point)[:2] + side * radius
        for q in positions
        for begin, end, radius in _capsules_at_pose(tree, tool, q)
        for point in (begin, end)
        for side in (-1.6, 1.6)
    ]
    every = np.vstack([*ends, seen])
    low, high = every.min(axis=0), every.max(axis=0)
    # Least extent of the view [m], for an arm whose joints and tool coincide.
    # Picture over content: lines have a width.
    wide, tall = 1.02 * np.maximum(high - low, 0.1)
    scale = min(WIDTH / wide, _HEIGHT_INCH / tall)
    middle = 0.5 * (low + high)
    half = 0.5 * np.array([WIDTH, _HEIGHT_INCH]) / scale
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    return float(72.0 * scale)


def _draw_arm(
    axes: Axes,
    tree: BodyTree,
    tool: LinkFrame,
    view: np.ndarray,
    q: np.ndarray,
    scale: float,
    colour: str,
    share: np.ndarray | None,
    opacity: float,
) -> None:
    """Draw capsules as thick lines from back to front, joints coloured by their share."""
    front = 10.0 if share is not None else 1.0
    parts = [
        (0.5 * (begin + end), np.stack([begin, end]), radius, colour)
        for begin, end, radius in _capsules_at_pose(tree, tool, q)
    ]
    if share is not None:
        for j, radius in enumerate(joint_radii(tree, tool)):
            # Shifted towards the viewer, in front of its links.
            at = _point_at_pose(tree, j + 1, np.zeros(3), q) + 1.5 * radius * view[2]
            parts.append((at, np.stack([at, at]), 0.62 * radius, _share_colour(float(share[j]))))
    depth = [float(view[2] @ middle) for middle, *_ in parts]
    for rank, k in enumerate(np.argsort(depth)):
        _, ends, radius, own = parts[k]
        flat = ends @ view.T
        width, order = 2.0 * radius * scale, front + 0.01 * rank
        if share is not None:
            _draw_capsule(axes, flat, GREY, width + 1.4, order, 1.0)
        _draw_capsule(axes, flat, own, width, order + 0.005, opacity)


def _draw_capsule(
    axes: Axes, flat: np.ndarray, colour: str, width: float, order: float, opacity: float
) -> None:
    """Draw a thick line with round ends; `width` in printed points."""
    axes.plot(
        flat[:, 0],
        flat[:, 1],
        color=colour,
        linewidth=width,
        zorder=order,
        alpha=opacity,
        solid_capstyle="round",
        # A line of zero length may not be drawn: a joint gets a marker.
        marker="o" if np.array_equal(flat[0], flat[1]) else None,
        markersize=width,
        markeredgewidth=0.0,
    )


def _share_colour(share: float) -> str:
    """Return the colour of a share as in the scene: full red from one half on."""
    own = min(max(2.0 * share, 0.0), 1.0)
    mixed = (1.0 - own) * np.array(to_rgb("#f2f4f6")) + own * np.array(to_rgb(VERMILLION))
    return "#" + "".join(f"{round(255 * c):02x}" for c in mixed)


@dataclass(frozen=True)
class ArmInSpace:
    """Still picture with caption, and the texts of the scene, which enter a page unescaped."""

    still: Figure
    caption: str
    embedded: dict[str, Markup]


def embedded_scene(
    robot: Robot, motions: Mapping[str, Poses], part: str, cell: Cell | None = None
) -> ArmInSpace:
    """Return scene and still of the first motion, its deflection magnified, the second as ghost.

    `part`: part of the deflection; the first nonzero one where it is zero. `cell`: cell around the
    arm.
    """
    first = next(iter(motions.values()))
    shown = part if part in first.bend else next(iter(first.bend), "")
    tool = frame_positions(robot.tree, robot.tool.in_base, first.position)
    extent = max(float(np.ptp(tool, axis=0).max()), 1e-3)
    factor = exaggeration(extent, float(first.deflection[shown].max())) if shown else 1.0
    still = still_figure(
        robot.tree, robot.tool.in_base, list(motions.values()), shown, factor, cell
    )
    here = resources.files("stiffopt.report.scene")
    texts = {
        "document": scene_json(scene_document(robot, motions, shown, factor, cell)),
        "library": here.joinpath("three.min.js").read_text(encoding="utf-8"),
        "script": here.joinpath("scene.js").read_text(encoding="utf-8"),
    }
    # Safe unescaped: scripts of this package, and JSON whose "<" is escaped.
    return ArmInSpace(
        still,
        still_caption(motions, shown, factor),
        {name: Markup(text) for name, text in texts.items()},
    )


def write_scene_page(
    title: str, robot: Robot, motions: Mapping[str, Poses], path: Path, cell: Cell | None = None
) -> Path:
    """Write a page of its own with a scene; return its path."""
    space = embedded_scene(robot, motions, "total", cell)
    figures = PageFigures(path.stem, svg=False, png=False)
    figures.draw("arm", space.still, "The arm with the paths of its tool")
    context = {"title": title, "space": space.embedded, "still": space.caption}
    return write_page("scene/page.html.j2", path, context, figures)
