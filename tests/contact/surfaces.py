"""Surfaces of the tests: the calibrated defaults and the pairs of materials."""

from stiffopt.contact.surface import Material, SurfacePair

STEEL = Material(name="steel", modulus=210e9, poisson=0.3, hardness=2.2e9)
ALUMINIUM = Material(name="cast aluminium", modulus=71e9, poisson=0.33, hardness=1.0e9)
IRON = Material(name="grey iron", modulus=120e9, poisson=0.27, hardness=2.0e9)


def steel_surface(dimension: float, roughness: float, **changes: object) -> SurfacePair:
    settings = {
        "name": "test",
        "first": STEEL,
        "second": STEEL,
        "fractal_dimension": dimension,
        "fractal_roughness": roughness,
    }
    return SurfacePair(**(settings | changes))


FINE = steel_surface(2.4, 1.29e-9)
ROUGH = steel_surface(2.4, 4.7e-9)
SURFACES = {
    "fine": FINE,
    "fine_2.3": steel_surface(2.3, 4.4e-11),
    "fine_2.5": steel_surface(2.5, 9.1e-9),
    "rough": ROUGH,
    "fine_aluminium": steel_surface(2.4, 1.29e-9, second=ALUMINIUM),
    "fine_iron": steel_surface(2.4, 1.29e-9, second=IRON),
}
