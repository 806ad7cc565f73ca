"""The parts that scenes are built from."""

from __future__ import annotations

import numpy as np

from lightmatrix.simulation.geometry import (
    Mesh,
    circle,
    extrude,
    hollow,
    l_outline,
    merge,
    polygon,
    rectangle,
    revolve,
    turn,
)


def sheet(size: float = 4.0) -> Mesh:
    """A flat square on z = 0."""
    half = size / 2
    corners = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    return Mesh(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]))


def l_block(leg: float, width: float, height: float) -> Mesh:
    """An L-shaped block lying flat, its middle at the origin in all three axes."""
    block = extrude(l_outline(leg, width), height, 0.05 * width, (width / 2, width / 2))
    return block.placed((-leg / 2, -leg / 2, -height / 2))


def bolt(radius: float, length: float, head_radius: float, head_height: float) -> Mesh:
    """A hexagon bolt along z, its head below; the middle of its length at the origin."""
    head = extrude(polygon(6, head_radius), head_height, 0.12 * head_height)
    threads = []
    pitch = 0.3 * radius
    z = head_height + 0.35 * length
    while z + pitch < head_height + length - pitch:
        threads += [(0.93 * radius, z), (radius, z + pitch / 2)]
        z += pitch
    end = head_height + length
    profile = [(radius, 0.5 * head_height), (radius, head_height + 0.34 * length), *threads]
    profile += [(0.95 * radius, end - 0.2 * radius), (0.75 * radius, end)]
    shaft = revolve(profile, 40)
    return merge([head, shaft]).placed((0, 0, -end / 2))


def nut(radius: float, hole: float, height: float) -> Mesh:
    """A hexagon nut standing on z = -height / 2."""
    ring = hollow(polygon(6, radius, points=48), circle(hole, 48), height, 0.08 * height)
    return ring.placed((0, 0, -height / 2))


def ring(radius: float, hole: float, height: float) -> Mesh:
    """A washer or bearing ring standing on z = -height / 2."""
    body = hollow(circle(radius), circle(hole), height, 0.1 * min(height, radius - hole))
    return body.placed((0, 0, -height / 2))


def bracket(leg: float, thickness: float, width: float) -> Mesh:
    """A bent plate: an L profile of the given width, its middle at the origin, lying on a side."""
    profile = extrude(l_outline(leg, thickness), width, 0.15 * thickness, (thickness / 2,) * 2)
    return profile.placed((-leg / 2, -leg / 2, -width / 2))


def box(width: float, depth: float, height: float, bevel: float) -> Mesh:
    """A box standing on z = 0 with bevelled upper and lower edges."""
    return extrude(rectangle(width, depth), height, bevel)


def rod(radius: float, length: float) -> Mesh:
    """A round rod along x, its middle at the origin."""
    profile = [
        (0.85 * radius, -length / 2),
        (radius, -length / 2 + 0.15 * radius),
        (radius, length / 2 - 0.15 * radius),
        (0.85 * radius, length / 2),
    ]
    return revolve(profile).placed(rotation=turn("y", 90))


def ball(radius: float, steps: int = 32) -> Mesh:
    """A ball standing on z = 0."""
    angle = np.pi * (np.arange(steps) + 0.5) / steps - np.pi / 2
    return revolve(np.column_stack([radius * np.cos(angle), radius * (1 + np.sin(angle))]))
