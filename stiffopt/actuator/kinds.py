"""Kinds of actuator that a recording set can name."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from stiffopt.actuator.cascade import Cascade
from stiffopt.actuator.position_servo import PositionServo
from stiffopt.actuator.voltage_motor import VoltageMotor

ActuatorKind = Annotated[PositionServo | Cascade | VoltageMotor, Field(discriminator="kind")]
