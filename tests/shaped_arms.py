"""Small arms whose links have shapes, and meshes for them."""

import struct

import numpy as np
from small_arms import PLANAR

from stiffopt.robot.files import load_robot

BOX = (
    '<visual><origin xyz="0.2 0 0" rpy="0 0 1.5707963267948966"/>'
    '<geometry><box size="0.1 0.4 0.1"/></geometry></visual>'
)
MESH = (
    "<{purpose}><geometry>"
    '<mesh filename="{name}" scale="0.001 0.001 0.001"/></geometry></{purpose}>'
)


def with_shapes(link, shapes):
    """PLANAR whose link has shapes."""
    return PLANAR.replace(
        f'<link name="{link}"><inertial>', f'<link name="{link}">{shapes}<inertial>'
    )


def write_stl(path, size=100.0):
    """A tetrahedron with right angles at the origin, edges of `size` along the axes."""
    corners = np.vstack([np.zeros(3), size * np.eye(3)])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    path.parent.mkdir(parents=True, exist_ok=True)
    data = b" " * 80 + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", *np.zeros(3), *corners[list(face)].ravel(), 0)
    path.write_bytes(data)


def load(folder, text):
    (folder / "arm.urdf").write_text(text)
    return load_robot(folder / "arm.urdf")
