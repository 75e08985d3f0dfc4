"""URDFs of a few links, written as their tests need them."""

from __future__ import annotations

MASS = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="3"/><inertia ixx="0.03" ixy="0" ixz="0"'
    ' iyy="0.03" iyz="0" izz="0.01"/></inertial>'
)
LIMIT = '<limit lower="-2" upper="2" effort="80" velocity="2"/>'


def joint(name, parent, child, inside=LIMIT, kind="revolute", axis="0 1 0", origin="0 0 0.3"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/><axis xyz="{axis}"/>{inside}</joint>'
        f'<link name="{child}">{MASS}</link>'
    )


def chain(count, *, prefix="", base="base", inside=LIMIT, mass=MASS):
    """Joints `prefix`1 ... in a row, from a base link; links are named `prefix`link1 ..."""
    found, parent = "", base
    for k in range(1, count + 1):
        child = f"{prefix}link{k}"
        axis = "0 0 1" if k % 3 == 1 else "0 1 0"
        found += joint(f"{prefix}{k}", parent, child, inside, axis=axis)
        parent = child
    return found.replace(MASS, mass)


def written(folder, *parts):
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>')
    return path


def limits(effort, velocity):
    return f'<limit lower="-2" upper="2" effort="{effort}" velocity="{velocity}"/>'


def changed(folder, changes, count=3):
    """The chain with texts replaced, once each, and the namespace of xacro."""
    urdf = written(folder, chain(count))
    text = urdf.read_text().replace("<robot", '<robot xmlns:xacro="http://ros.org/xacro"')
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    urdf.write_text(text)
    return urdf
