"""Machine connections: torque [N m] to wind-up [rad], one kind a file.

Every class in a file of this folder that has a `kind` can stand in robot files under that name.
"""

from importlib import import_module
from pkgutil import iter_modules

from stiffopt.connection.bolted_flange import BoltedFlange
from stiffopt.connection.clamping_pins import ClampingPins
from stiffopt.connection.connection import Connection, ContactConnection, LinearConnection
from stiffopt.connection.constant import Constant
from stiffopt.connection.fastener import Bolt, FlangeRing, SetScrew
from stiffopt.connection.gear_pair import GearPair
from stiffopt.connection.key import Key
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
    "FlangeRing",
    "GearPair",
    "Key",
    "LinearConnection",
    "Reducer",
    "SetScrew",
    "Shaft",
    "TimingBelt",
]

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
