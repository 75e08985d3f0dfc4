"""Machine connections: torque [N m] to wind-up [rad], one kind a file."""

from stiffopt.connection.bolted_flange import BoltedFlange
from stiffopt.connection.clamping_pins import ClampingPins
from stiffopt.connection.connection import Connection, ContactConnection
from stiffopt.connection.constant import Constant
from stiffopt.connection.fastener import Bolt, SetScrew
from stiffopt.connection.gear_pair import GearPair
from stiffopt.connection.key import Key
from stiffopt.connection.linear import LinearConnection
from stiffopt.connection.reducer import Reducer
from stiffopt.connection.shaft import Shaft
from stiffopt.connection.timing_belt import TimingBelt

__all__ = [
    "Bolt",
    "BoltedFlange",
    "ClampingPins",
    "Connection",
    "Constant",
    "ContactConnection",
    "GearPair",
    "Key",
    "LinearConnection",
    "Reducer",
    "SetScrew",
    "Shaft",
    "TimingBelt",
]
