"""Dimensions of a bolt in a flange: head, shank, nut, clamp length."""

from __future__ import annotations

from dataclasses import replace

from stiffopt.connection import Bolt
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.fasteners import BoltData
from stiffopt.errors import InputError

# Default clamp length in bolt diameters.
DEFAULT_CLAMP_LENGTH_RATIO = 2.0


def clamp_length(bolt: Bolt) -> float:
    """Clamp length l_K, given or default [m]."""
    if bolt.clamp_length is not None:
        return bolt.clamp_length
    return DEFAULT_CLAMP_LENGTH_RATIO * catalogue.bolt(bolt.size).diameter


def bolt_data(bolt: Bolt) -> BoltData:
    """Return the dimensions of a bolt with head and shank; a thin shank sets the stress area.

    Raises
    ------
    InputError
        The shank is thicker than the bolt or longer than the clamp length, an engagement is given
        for a bolt with a nut, or a stainless thread is rolled after heat treatment.
    """
    data = catalogue.bolt(bolt.size)
    if bolt.head == "hexagon":
        face = catalogue.hexagon(bolt.size)
        data = replace(data, head_diameter=face.corners, bearing_diameter=face.bearing_diameter)
    if bolt.nut and bolt.engagement is not None:
        raise InputError(
            f"bolt {bolt.size}: engagement belongs to a tapped hole, and this bolt has a nut. "
            "Leave engagement out, or set `nut = false`."
        )
    if bolt.rolled == "after" and not catalogue.bolt_grade(bolt.grade).heat_treated:
        raise InputError(
            f'bolt {bolt.size} {bolt.grade}: rolled = "after" means after heat treatment, and '
            "stainless bolts have none. Leave rolled out."
        )
    if bolt.shank_diameter is None and not bolt.shank_length:
        return data
    diameter = data.diameter if bolt.shank_diameter is None else bolt.shank_diameter
    length = clamp_length(bolt) if bolt.shank_length is None else bolt.shank_length
    if diameter > data.diameter:
        raise InputError(
            f"bolt {bolt.size}: shank_diameter = {1e3 * diameter:g} mm must be at most that of the "
            f"bolt, {1e3 * data.diameter:g} mm. Give the diameter beside the thread, or leave it "
            "out."
        )
    if length > clamp_length(bolt) * (1 + 1e-9):
        raise InputError(
            f"bolt {bolt.size}: shank_length = {1e3 * length:g} mm must be at most clamp_length, "
            f"{1e3 * clamp_length(bolt):g} mm. Give the part of the shank between head and thread "
            "that lies within the clamp length."
        )
    return catalogue.shanked(data, diameter, length)
