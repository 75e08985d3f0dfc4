"""Two MJCFs: an arm with much that MJCF allows, and two legs on a free base."""

from __future__ import annotations

from pathlib import Path

# Degrees, extrinsic Euler angles, nested defaults, a frame, an include, masses by shapes, two
# joints of one body, anchors off the body's origin, a reference, a mesh that is not there.
ARM = """<mujoco model="odd">
  <compiler angle="degree" eulerseq="XYZ" autolimits="true" meshdir="nowhere"/>
  <include file="../parts/defaults.xml"/>
  <asset><mesh name="shell" file="shell.stl"/></asset>
  <worldbody>
    <body name="base" pos="0.1 0 0.2" euler="20 30 -40">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <frame pos="0 0.05 0.1" euler="0 90 15">
        <body name="shoulder" childclass="big">
          <inertial pos="0.02 0.01 0.1" mass="2.5"
            fullinertia="0.02 0.03 0.025 0.001 -0.002 0.003"/>
          <geom type="mesh" mesh="shell"/>
          <joint name="pan" axis="0 1 1" range="-100 120" ref="25" pos="0.03 0 -0.02"/>
          <joint name="lift" axis="1 0 0" range="-90 90" pos="0 0.01 0.05" class="small"/>
          <body name="slider" pos="0 0.1 0.3" euler="10 0 80">
            <geom type="capsule" size="0.04 0.1" pos="0.05 0 0" density="900"/>
            <!-- the lead screw; "<joint name='pan'/>" is above -->
            <joint name="slide" type='slide'  axis="0 0 -1" range="-0.1 0.2" ref="0.03"
              stiffness="40" springref="0.1"/>
            <body name="hand" pos="0 0 0.2"
                  euler="0 90 0">
              <geom type="box" size="0.03 0.05 0.02" mass="0.7" pos="0.01 0.02 0.03"/>
              <joint name="roll" axis="0 0 1"/>
              <site name="tcp" pos="0 0 0.1" euler="0 0 30"/>
            </body>
          </body>
        </body>
      </frame>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="pan" kp="50" kv="2" gear="2" forcerange="-30 30"/>
    <motor name="drive" joint="lift" gear="10" ctrlrange="-4 4"/>
  </actuator>
</mujoco>
"""
DEFAULTS = """<mujocoinclude>
  <default>
    <joint damping="0.5"/>
    <default class="big"><joint armature="0.3" frictionloss="1.5"/>
      <default class="small"><joint armature="0.1" frictionloss="0.4"/></default>
    </default>
  </default>
</mujocoinclude>
"""

LEGS = """<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 0.5">
      <freejoint name="floating"/>
      <geom type="box" size="0.2 0.1 0.05" mass="6"/>
      {legs}
    </body>
    <body name="ball"><freejoint/><geom size="0.1" mass="0.2"/></body>
  </worldbody>
</mujoco>
"""
LEG = """<body name="hip_{k}" pos="0.2 {y} 0"><joint name="hip_{k}" axis="1 0 0"/>
  <geom size="0.04" mass="0.6"/>
  <body name="thigh_{k}" pos="0 0.05 0"><joint name="thigh_{k}" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03" mass="1"/>
    <body name="calf_{k}" pos="0 0 -0.2"><joint name="calf_{k}" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/></body></body></body>"""


def write_arm(folder: Path) -> Path:
    """Write the arm, with its defaults in another file."""
    (folder / "parts").mkdir()
    (folder / "parts" / "defaults.xml").write_text(DEFAULTS)
    (folder / "arm").mkdir()
    (folder / "arm" / "odd.xml").write_text(ARM)
    return folder / "arm" / "odd.xml"


def write_legs(folder: Path) -> Path:
    """Write two legs on a free trunk, beside a ball."""
    both = "".join(LEG.format(k=k, y=y) for k, y in (("l", 0.1), ("r", -0.1)))
    (folder / "legs.xml").write_text(LEGS.format(legs=both))
    return folder / "legs.xml"
