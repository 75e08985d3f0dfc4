"""Arms whose bearings are joints of their own: finite rotations, with no formula of the package.

Every joint with a bearing is followed by joints of radial, axial and tilt motion on springs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.integrate import odeint
from scipy.spatial.transform import Rotation

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.motor import MotorMotion
from stiffopt.robot.robot import Robot


@dataclass
class TiltingArm:
    """Model with a joint for each component of each bearing.

    Parameters
    ----------
    model : pinocchio.Model
    driven : array (n,)
        Places of the robot's joints among those of the model.
    stiffness : array (m,)
        Of the springs; zero for driven joints.
    tool : (int, pin.SE3)
    """

    model: pin.Model
    driven: np.ndarray
    stiffness: np.ndarray
    tool: tuple[int, pin.SE3]

    def tool_pose(self, q: np.ndarray) -> pin.SE3:
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q)
        return data.oMi[self.tool[0]] * self.tool[1]

    def static_position(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Equilibrium (m,) with the driven joints held at q (n,) and a force on the tool."""
        free = self.stiffness > 0.0
        found = np.zeros(self.model.nq)
        found[self.driven] = q
        for _ in range(50):
            new = self._load(found, force)[free] / self.stiffness[free]
            if np.max(np.abs(new - found[free]), initial=0.0) < 1e-14:
                return found
            found[free] = new
        raise AssertionError("no equilibrium")

    def driven_torque(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Torque (n,) of force and weight on the driven joints in a pose (m,)."""
        return self._load(q, force)[self.driven]

    def _load(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        data = self.model.createData()
        weight = pin.computeGeneralizedGravity(self.model, data, q)
        pin.computeJointJacobians(self.model, data, q)
        at = data.oMi[self.tool[0]] * self.tool[1]
        jacobian = pin.getJointJacobian(self.model, data, self.tool[0], pin.LOCAL_WORLD_ALIGNED)
        lever = at.translation - data.oMi[self.tool[0]].translation
        return jacobian[:3].T @ force + jacobian[3:].T @ np.cross(lever, force) - weight


def tilting_arm(robot: Robot) -> TiltingArm:
    model, stiffness, driven, end_of = pin.Model(), [], [], {0: 0}
    shift = {0: pin.SE3.Identity()}  # from the last joint of a body to its own frame
    model.gravity = robot.model.gravity
    for i in range(1, robot.model.njoints):
        parent = int(robot.model.parents[i])
        joint = robot.model.joints[i]
        at = shift[parent] * robot.model.jointPlacements[i]
        last = model.addJoint(end_of[parent], _same_kind(joint), at, f"driven {i}")
        driven.append(len(stiffness))
        stiffness.append(0.0)
        bearing = robot.bearings[i - 1] if robot.bearings else None
        back = pin.SE3.Identity()
        if bearing is not None:
            axis = robot.tree.bodies[i - 1].axis
            third = axis / np.linalg.norm(axis)
            turned = Rotation.align_vectors([third], [[0.0, 0.0, 1.0]])[0].as_matrix()
            place = pin.SE3(turned, bearing.position * third)
            back = place.inverse()
            kinds = [
                (pin.JointModelPX(), bearing.radial_stiffness),
                (pin.JointModelPY(), bearing.radial_stiffness),
                (pin.JointModelPZ(), bearing.axial_stiffness),
                (pin.JointModelRX(), bearing.moment_stiffness),
                (pin.JointModelRY(), bearing.moment_stiffness),
            ]
            for kind, spring in kinds:
                if spring is not None:
                    name = f"{kind.shortname()} {i}"
                    last = model.addJoint(last, kind, place, name)
                    place = pin.SE3.Identity()
                    stiffness.append(spring)
        end_of[i], shift[i] = last, back
        model.appendBodyToJoint(last, robot.model.inertias[i], back)
    tool = robot.tool
    frame = shift[tool.joint] * pin.SE3(tool.rotation, tool.offset)
    return TiltingArm(model, np.array(driven), np.array(stiffness), (end_of[tool.joint], frame))


def _same_kind(joint: pin.JointModel) -> object:
    name = joint.shortname()
    if name.endswith("Unaligned"):
        return joint
    return getattr(pin, name)()


def simulated_tool(
    arm: TiltingArm, elastic: ElasticArm, motors: MotorMotion, times: np.ndarray
) -> list[pin.SE3]:
    """Poses of the tool with the torsion springs of an arm, from rest in equilibrium.

    The springs of the bearings have 2 % of critical damping.
    """
    model, data, free = arm.model, arm.model.createData(), arm.stiffness > 0.0
    start = elastic.static_equilibrium(motors.at(0.0)[0][None])[0]
    q = arm.static_position(start, np.zeros(3))
    for _ in range(20):  # torsion and tilt in turn
        weight = pin.computeGeneralizedGravity(model, data, q)[arm.driven]
        start = motors.at(0.0)[0] - elastic.windup(weight[None])[0]
        q = arm.static_position(start, np.zeros(3))
    inertia = np.diag(pin.crba(model, data, q))
    damping = np.where(free, 0.04 * np.sqrt(arm.stiffness * inertia), 0.0)
    springs, n = elastic.springs, model.nq

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        at, v = state[:n], state[n:]
        motor, speed = motors.at(t)
        torque = -arm.stiffness * at - damping * v
        for j, place in enumerate(arm.driven):
            spring = springs[j]
            assert spring is not None
            torque[place] = spring.torque_alone(motor[j] - at[place])
            torque[place] += elastic.damping[j] * (speed[j] - v[place])
        return np.concatenate([v, pin.aba(model, data, at, v, torque)])

    state = np.concatenate([q, np.zeros(n)])
    found = odeint(slope, state, times, tfirst=True, rtol=1e-8, atol=1e-10, mxstep=100000)
    return [arm.tool_pose(row[:n]) for row in found]
