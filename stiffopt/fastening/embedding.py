"""R4: how far the faces of a bolted joint settle after assembly (VDI 2230 Table 5)."""

from __future__ import annotations

from stiffopt.connection import BoltedFlange
from stiffopt.errors import OutOfValidityError

# Roughness Rz up to [m], then um in the thread, at each head or nut, at each inner face; by load.
_EMBEDDING_BY_ROUGHNESS = {
    "axial": ((10e-6, 3.0, 2.5, 1.5), (40e-6, 3.0, 3.0, 2.0), (160e-6, 3.0, 4.0, 3.0)),
    "shear": ((10e-6, 3.0, 3.0, 2.0), (40e-6, 3.0, 4.5, 2.5), (160e-6, 3.0, 6.5, 3.5)),
}


def embedding(
    roughness: float, interfaces: int, load: str = "shear", *, nut: bool = False
) -> float:
    """f_Z of a bolt [m]: thread, head, nut where there is one, and inner faces (Table 5).

    Parameters
    ----------
    roughness : float
        Rz [m], of the roughest face.
    interfaces : int
        Inner faces, those at washers among them.
    load : {"shear", "axial"}
        Working load; shear settles more and is taken where there are both.
    nut : bool
        Settles as a head does; in a tapped hole nothing does but the thread.
    """
    for bound, thread, head, inner in _EMBEDDING_BY_ROUGHNESS[load]:
        if roughness < bound:
            bearing = 2 if nut else 1
            return 1e-6 * (thread + bearing * head + interfaces * inner)
    raise OutOfValidityError("roughness", roughness, 0.0, 160e-6, "Table 5 of VDI 2230 ends there.")


def flange_embedding(flange: BoltedFlange) -> float:
    """f_Z of a flange's bolts [m]; torque is a shear load of the face."""
    bolt = flange.bolt
    nut = bolt is not None and bolt.nut
    washers = (2 if nut else 1) if bolt is not None and bolt.washer else 0
    return embedding(flange.roughness, flange.interfaces + washers, nut=nut)
