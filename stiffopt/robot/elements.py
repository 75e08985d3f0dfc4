"""From the sections of a robot file to connections and chains."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from stiffopt.contact.surface import SurfacePair
from stiffopt.declaration import declared, unit
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.robot.element_sections import ElementSection
from stiffopt.robot.schema import AssemblySection, JointSection, SurfaceSection
from stiffopt.units import JointNumber, fit_joint


class ElementBuilder:
    """Builds the chains of a robot file.

    Parameters
    ----------
    path : the file, for messages
    assembly : AssemblySection
    surfaces : mapping of name to SurfaceSection
        Of the file; they come before those of the catalogue.
    """

    def __init__(
        self, path: object, assembly: AssemblySection, surfaces: Mapping[str, SurfaceSection]
    ) -> None:
        self.path, self.assembly = path, assembly
        self.surfaces: dict[str, SurfacePair] = {}
        for name, section in surfaces.items():
            with located(path, f"surface.{name}"):
                self.surfaces[name] = _surface(name, section)

    def chain(self, joint: JointSection, torque_max: float, prismatic: bool) -> Chain | None:
        """Chain of a joint with the largest torque `torque_max` [N m]; None without elements."""
        if not joint.element:
            return None
        stages = []
        for section in joint.element:
            with located(self.path, f"joint[{joint.name}].element[{section.name}]"):
                stages.append(self._stage(section, torque_max, prismatic))
        with located(self.path, f"joint[{joint.name}]"):
            _check_inputs(joint.element)
            return Chain(tuple(stages), reflect=self.assembly.reflect)

    def _stage(self, section: ElementSection, torque_max: float, prismatic: bool) -> Stage:
        kind = section.connection
        values = section.connection_fields()
        for name, value in values.items():
            if isinstance(value, JointNumber):
                values[name] = fit_joint(value, prismatic, unit(kind, name).dimension, name)
        if "surface" in values:
            values["surface"] = self._pair(values["surface"])
        # What the whole robot has in common.
        common = {"contact_law": self.assembly.contact_law, "shear": self.assembly.shear}
        values |= {name: law for name, law in common.items() if name in kind.__dataclass_fields__}
        element = kind(
            name=section.name,
            torque_max=torque_max / (section.ratio * section.efficiency),
            **values,
        )
        return Stage(element, section.ratio, section.efficiency, section.parallel)

    def _pair(self, name: str) -> SurfacePair:
        return replace(self._surface(name), loading=self.assembly.loading)

    def _surface(self, name: str) -> SurfacePair:
        if name in self.surfaces:
            return self.surfaces[name]
        known = [*self.surfaces, *catalogue.surface_names()]
        if name not in known:
            raise InputError(f"surface: no surface {name!r}. {nearest(name, known)}")
        return catalogue.surface(name)


def _check_inputs(sections: Sequence[ElementSection]) -> None:
    """Raise `InputError` for an element that turns unlike the input of the reducer after it.

    Only a reducer of the catalogue says how often its input turns. The one after or before it by a
    turn is that of a strain-wave gear whose other part is held.
    """
    for reducer, before in zip(sections[1:], sections, strict=False):
        name = getattr(reducer, "catalogue", None)
        if name is None or before.parallel is not None:
            continue
        turns = catalogue.reducer(name).ratio
        # Teeth between the element's own shaft and the reducer.
        teeth = float(getattr(before, "teeth", 1.0))
        geared = float(getattr(before, "teeth_driven", None) or teeth) / teeth
        wanted = reducer.ratio * turns * geared
        if abs(before.ratio - wanted) > 1.001 * reducer.ratio * geared:
            raise InputError(
                f"element[{before.name}].ratio = {before.ratio:g}, but the input of"
                f" {reducer.name!r} ({name}) after it turns {turns} times for one turn of its"
                f" output: give ratio = {wanted:g}, list the belt or gears between the two, or give"
                " K1, K2, K3, T1 and T2 in place of `catalogue`."
            )


def _surface(name: str, section: SurfaceSection) -> SurfacePair:
    values: dict[str, Any] = {key: getattr(section, key) for key in declared(SurfacePair)}
    for key, body in values.items():
        if isinstance(body, str):
            values[key] = catalogue.material(body)
    return SurfacePair(name=name, **values)


@contextlib.contextmanager
def located(path: object, where: str) -> Iterator[None]:
    """Add file and key to what the objects inside say about their numbers."""
    try:
        yield
    except InputFileError:
        raise
    except InputError as error:
        raise InputFileError(path, where, str(error)) from error
