"""What every format of an exported robot must answer, and the registry that holds them."""

from __future__ import annotations

from abc import ABC, abstractmethod

from stiffopt.export.found import DiagnosedRobot
from stiffopt.problem.registry import Registry


class ModelFormat(ABC):
    """A way to hand a robot to others.

    Attributes
    ----------
    name : str
        Of `--to`.
    file : str
        That is written.
    """

    name: str
    file: str

    @abstractmethod
    def text(self, found: DiagnosedRobot) -> str:
        """Content of the file."""

    def remarks(self, found: DiagnosedRobot) -> list[str]:
        """What else is not in it as in the robot, a line each."""
        return []


def notes(found: DiagnosedRobot) -> list[str]:
    """What was changed and what has no place in such a model, a line each."""
    lines = [
        f"{each.quantity} of {each.name}: {each.old:.6g} -> {each.new:.6g} {each.unit}"
        for each in found.changes
    ]
    lines += [
        f"torque given for one reported by {name}: 1 -> {gain:.6g}"
        for name, gain in zip(found.robot.joint_names, found.gain, strict=True)
        if gain != 1.0
    ]
    lines += [f"found, but no value of such a model: {each}" for each in found.left_out]
    return lines or ["nothing was found that changes a value"]


MODEL_FORMATS: Registry[ModelFormat] = Registry("stiffopt.export.model_formats")
