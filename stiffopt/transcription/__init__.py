"""From an optimal-control problem to a nonlinear programme and back."""

from stiffopt.transcription.build import METHODS, transcribe
from stiffopt.transcription.mesh import Mesh, uniform_mesh
from stiffopt.transcription.nlp import Entry, Nlp, Violation
from stiffopt.transcription.ocp import Guess, OptimalControlProblem, Rows, Waypoint
from stiffopt.transcription.refine import refine_mesh
from stiffopt.transcription.transcription import Transcription, Unpacked

__all__ = [
    "METHODS",
    "Entry",
    "Guess",
    "Mesh",
    "Nlp",
    "OptimalControlProblem",
    "Rows",
    "Transcription",
    "Unpacked",
    "Violation",
    "Waypoint",
    "refine_mesh",
    "transcribe",
    "uniform_mesh",
]
