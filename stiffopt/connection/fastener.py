"""What holds a bolted flange or a pinned shaft together: one bolt, one set screw."""

from __future__ import annotations

from dataclasses import dataclass

from stiffopt.contact.validate import require_positive


@dataclass(frozen=True, kw_only=True)
class Bolt:
    """One of the equal bolts of a flange, screwed into a tapped hole.

    Names of sizes, grades and materials are those of the catalogue; they are looked up where they
    are needed.

    Parameters
    ----------
    size : str
        Such as "M5".
    grade : str
        Strength class of ISO 898-1.
    clamp_length : float or None
        l_K, thickness that the bolt clamps [m]; None: two bolt diameters, an estimate.
    engagement : float or None
        m_eff, length of thread that carries [m]; None: by the material of the thread, an estimate.
    head_material : str
        Of the part under the head: steel, iron or aluminium.
    thread_material : str
        Of the part with the tapped hole.
    """

    size: str
    grade: str = "12.9"
    clamp_length: float | None = None
    engagement: float | None = None
    head_material: str = "steel"
    thread_material: str = "steel"

    def __post_init__(self) -> None:
        for name in ("clamp_length", "engagement"):
            value = getattr(self, name)
            if value is not None:
                require_positive(f"bolt {self.size}", **{name: value})


@dataclass(frozen=True, kw_only=True)
class SetScrew:
    """Set screw that presses the tip of a pin on a shaft, or is the pin itself.

    Parameters
    ----------
    size : str
        Such as "M4".
    length : float or None
        [m]; None: one and a half diameters, an estimate.
    shaft_material : str
        Of the shaft under the tip: hardened_steel or steel_45.
    """

    size: str = "M4"
    length: float | None = None
    shaft_material: str = "hardened_steel"

    def __post_init__(self) -> None:
        if self.length is not None:
            require_positive(f"set screw {self.size}", length=self.length)
