"""Transcription of an optimal-control problem into a nonlinear programme, and back."""

from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import Mesh, refine_mesh, uniform_mesh
from stiffopt.transcription.nlp import Nlp, NlpEntry, RowViolation
from stiffopt.transcription.ocp import Guess, OptimalControlProblem, Rows, Waypoint
from stiffopt.transcription.schemes import SCHEMES
from stiffopt.transcription.transcription import Transcription, Unpacked

__all__ = [
    "SCHEMES",
    "Guess",
    "Mesh",
    "Nlp",
    "NlpEntry",
    "OptimalControlProblem",
    "RowViolation",
    "Rows",
    "Transcription",
    "Unpacked",
    "Waypoint",
    "refine_mesh",
    "transcribe",
    "uniform_mesh",
]
