"""Public names and where they are defined; `__init__.py` loads them on first use."""

from .certificate.assess import assess as assess
from .discovery.diagnose import diagnose as diagnose
from .discovery.diagnose import diagnose_change as diagnose_change
from .discovery.diagnosis import Diagnosis as Diagnosis
from .discovery.store import write_diagnosis as write_diagnosis
from .errors import InputError as InputError
from .errors import NoSolutionFound as NoSolutionFound
from .errors import ProblemError as ProblemError
from .errors import StiffoptError as StiffoptError
from .fastening.tightening import Tightening as Tightening
from .identification.stiffness import identify_stiffness as identify_stiffness
from .path.load import load_problem as load_problem
from .preload.files import load_study as load_study
from .preload.load_case import LoadCase as LoadCase
from .preload.optimise import optimise_preloads as optimise_preloads
from .preload.problem import Choice as Choice
from .preload.problem import PreloadProblem as PreloadProblem
from .preload.problem import Requirements as Requirements
from .preload.study import preload_study as preload_study
from .problem.limit import Limits as Limits
from .problem.objective import Objective as Objective
from .problem.trajectory import Method as Method
from .problem.trajectory import Target as Target
from .problem.trajectory import TrajectoryProblem as TrajectoryProblem
from .recording.recording_set import load_recordings as load_recordings
from .recording.static_set import load_static_set as load_static_set
from .report.diagnosis.page import write_diagnosis_report as write_diagnosis_report
from .report.preload.page import write_preload_report as write_preload_report
from .report.solve.page import write_solve_report as write_solve_report
from .result.solution import Solution as Solution
from .result.status import SolveStatus as SolveStatus
from .result.trajectory import Trajectory as Trajectory
from .robot.files import load_robot as load_robot
from .robot.files import shipped_robots as shipped_robots
from .robot.robot import Robot as Robot
from .robot.stiffness_study import stiffness_study as stiffness_study
from .solver.solve import solve as solve

__version__: str
