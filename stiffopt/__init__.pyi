"""Public names and where they are defined; `__init__.py` loads them on first use."""

from stiffopt.certificate.assess import assess as assess
from stiffopt.discovery.diagnose import diagnose as diagnose
from stiffopt.discovery.diagnosis import Diagnosis as Diagnosis
from stiffopt.discovery.store import write_diagnosis as write_diagnosis
from stiffopt.errors import InputError as InputError
from stiffopt.errors import NoSolutionFound as NoSolutionFound
from stiffopt.errors import ProblemError as ProblemError
from stiffopt.errors import StiffoptError as StiffoptError
from stiffopt.fastening.tightening import Tightening as Tightening
from stiffopt.identification.stiffness import identify_stiffness as identify_stiffness
from stiffopt.preload.files import load_study as load_study
from stiffopt.preload.load_case import LoadCase as LoadCase
from stiffopt.preload.optimise import optimise_preloads as optimise_preloads
from stiffopt.preload.problem import Choice as Choice
from stiffopt.preload.problem import PreloadProblem as PreloadProblem
from stiffopt.preload.problem import Requirements as Requirements
from stiffopt.preload.study import preload_study as preload_study
from stiffopt.problem.files import load_problem as load_problem
from stiffopt.problem.limit import Limits as Limits
from stiffopt.problem.objective import Objective as Objective
from stiffopt.problem.trajectory import Method as Method
from stiffopt.problem.trajectory import Target as Target
from stiffopt.problem.trajectory import TrajectoryProblem as TrajectoryProblem
from stiffopt.recording.recording_set import load_recordings as load_recordings
from stiffopt.recording.static_set import load_static_set as load_static_set
from stiffopt.report.diagnosis.page import write_diagnosis_report as write_diagnosis_report
from stiffopt.report.preload.page import write_preload_report as write_preload_report
from stiffopt.report.solve.page import write_solve_report as write_solve_report
from stiffopt.result.solution import Solution as Solution
from stiffopt.result.status import SolveStatus as SolveStatus
from stiffopt.result.trajectory import Trajectory as Trajectory
from stiffopt.robot.files import load_robot as load_robot
from stiffopt.robot.files import shipped_robots as shipped_robots
from stiffopt.robot.robot import Robot as Robot
from stiffopt.robot.stiffness_study import stiffness_study as stiffness_study
from stiffopt.solver.solve import solve as solve

__version__: str
