"""ER3A joints in the configuration of the reference tables: series flanks, no pre-pressure."""

from __future__ import annotations

from dataclasses import replace

from stiffopt.connection import BoltedFlange, ClampingPins, Key
from stiffopt.contact.surrogate import PowerLaw
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain

# One-term fits of the reference tables: c at 1 MPa [N/m^3], exponent.
POWER = {"fine_steel": (1.7985e12, 0.8604), "rough_steel": (6.7216e11, 0.8789)}


_FLANKS = ("shaft_flank_height", "hub_flank_height")
# Bearing heights in the shaft of the tables' output-side keys [m].
_KEYWAYS = {3.5e-3: (4.0e-3, 3.3e-3), 2.5e-3: (3.0e-3, 2.3e-3)}


def table_chain(chain: Chain, surface: str, *, prepressure: float = 0.0, law: str = "exact"):
    """Same elements with all keys in series, one surface, and the tables' pre-pressure."""
    stages = []
    for stage in chain.stages:
        element = stage.element
        if isinstance(element, Key | BoltedFlange | ClampingPins):
            extra = {"surface": catalogue.surface(surface)}
            if law == "power":
                c, m = POWER[surface]
                extra["contact_law"] = PowerLaw(coefficient=c, exponent=m)
            if isinstance(element, ClampingPins):
                # The tables count the bore with the full force of both screws.
                extra["spacing"] = 0.0
            if isinstance(element, Key) and element.name == "output_key":
                # The tables have the whole keyways bear, chamfers and all: more than the key is.
                extra |= dict(zip(_FLANKS, _KEYWAYS[element.shaft_flank_height], strict=True))
            if isinstance(element, Key):
                extra |= {"flanks": "series", "prepressure": prepressure}
            element = replace(element, **extra)
        stages.append(replace(stage, element=element))
    return replace(chain, stages=tuple(stages))
