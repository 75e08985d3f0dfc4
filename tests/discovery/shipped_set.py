"""The recording set that is shipped, and what its nominal model lacks."""

from pathlib import Path

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect

SHIPPED = Path(__file__).parents[2] / "problems" / "recordings" / "two_link_friction"
LACKS = Extension(
    effects=(
        EstimatedEffect(
            located=LocatedEffect(effect=effect("coulomb"), joint=1), amplitudes=(0.62,)
        ),
    )
)
