"""Checks of a head's solids before anything is made: closed, apart, thick enough, and out of the light.

What is computed here is geometry of the drawings. No part has been made or measured.
"""

from __future__ import annotations

import dataclasses
from typing import Iterable

import fcl
import numpy as np
import trimesh
from build123d import Part
from numpy.typing import NDArray

from .layout import Float, Layout
from .solids import Placed, is_foil

#: Deviation of meshes from the solids, mm and rad; coarser for the tool's motion.
CHORD = 0.02
CHORD_ANGLE = 0.2
MOTION_CHORD = 0.05
MOTION_CHORD_ANGLE = 0.5
#: Solids that touch may share this volume, mm³: rounding of planes that coincide.
MAX_SHARED_MM3 = 1e-4
#: Least distance from tool to housing, mm: deviation of both meshes, and as much again for the parts.
MIN_GAP = 0.2
#: Walls thinner than this cannot be printed or milled reliably, mm.
MIN_WALL = 0.8
#: Faces count as a wall if their normals are antiparallel within 26 degrees: countersinks and cones run out to edges.
WALL_COSINE = 0.9


def mesh(solid: Part, chord: float = CHORD, angle: float = CHORD_ANGLE) -> trimesh.Trimesh:
    """Triangles of a solid, each vertex once."""
    vertices, triangles = solid.tessellate(chord, angle)
    return trimesh.Trimesh([(v.X, v.Y, v.Z) for v in vertices], triangles, process=True, validate=True)


def faults(placed: Iterable[Placed]) -> list[str]:
    """Solids that are not one closed, valid body."""
    found = []
    for name, solid in {part.name: part.solid for part in placed}.items():
        bodies = len(solid.solids())
        if bodies != 1 or not solid.is_valid or solid.volume <= 0.0:
            found.append(
                f"{name}: {bodies} bodies, {'valid' if solid.is_valid else 'not valid'}, {solid.volume:.3f} mm³"
            )
        elif not mesh(solid).is_watertight:
            found.append(f"{name}: its mesh is not closed")
    return found


def overlaps(placed: list[Placed]) -> list[str]:
    """Pairs of parts that share volume with the tool at home."""
    solids = [part.in_place for part in placed]
    boxes = [solid.bounding_box() for solid in solids]
    low, high = (
        np.array([(c.X, c.Y, c.Z) for c in corner]) for corner in ([b.min for b in boxes], [b.max for b in boxes])
    )
    found = []
    for i in range(len(placed)):
        for j in np.flatnonzero((low[i] < high[i + 1 :]).all(axis=1) & (high[i] > low[i + 1 :]).all(axis=1)) + i + 1:
            common = solids[i].intersect(solids[j])
            volume = 0.0 if common is None else sum(solid.volume for solid in common.solids())
            if volume > MAX_SHARED_MM3:
                found.append(f"{placed[i].label} and {placed[j].label}: {volume:.4f} mm³")
    return found


def _model(solids: Iterable[Part]) -> fcl.CollisionObject:
    whole = trimesh.util.concatenate([mesh(solid, MOTION_CHORD, MOTION_CHORD_ANGLE) for solid in solids])
    model = fcl.BVHModel()
    model.beginModel(len(whole.vertices), len(whole.faces))
    model.addSubModel(whole.vertices, whole.faces)
    model.endModel()
    return fcl.CollisionObject(model)


@dataclasses.dataclass(frozen=True)
class Clearance:
    """Tool against housing over the workspace.

    :ivar poses: how many.
    :ivar colliding: at how many of them they touch.
    :ivar least: least distance, mm; 0 if they touch.
    :ivar worst: where: translation, mm.
    """

    poses: int
    colliding: int
    least: float
    worst: tuple[float, float, float]


def clearance(placed: list[Placed], poses: tuple[Float, Float]) -> Clearance:
    """Distance from tool to housing at every pose."""
    tool = _model(part.in_place for part in placed if part.on_tool)
    base = _model(part.in_place for part in placed if not part.on_tool)
    colliding, least, worst = 0, np.inf, np.zeros(3)
    for translation, turned in zip(*poses):
        tool.setTransform(fcl.Transform(turned, translation))
        touching = fcl.collide(tool, base, fcl.CollisionRequest(), fcl.CollisionResult()) > 0
        colliding += touching
        distance = 0.0 if touching else fcl.distance(tool, base, fcl.DistanceRequest(), fcl.DistanceResult())
        if distance < least:
            least, worst = distance, translation
    return Clearance(len(poses[0]), int(colliding), float(least), (float(worst[0]), float(worst[1]), float(worst[2])))


def hits(start: Float, end: Float, obstacle: trimesh.Trimesh) -> NDArray[np.bool_]:
    """Which segments (N, 3), (N, 3) meet a mesh (Möller and Trumbore 1997)."""
    low = np.minimum(start, end).min(axis=0)
    high = np.maximum(start, end).max(axis=0)
    triangles = obstacle.triangles
    near = (triangles.min(axis=1) <= high).all(axis=1) & (triangles.max(axis=1) >= low).all(axis=1)
    hit = np.zeros(len(start), dtype=bool)
    ray = end - start
    for corner, second, third in triangles[near]:
        first_side, second_side = second - corner, third - corner
        cross = np.cross(ray, second_side)
        determinant = cross @ first_side
        with np.errstate(divide="ignore", invalid="ignore"):
            from_corner = start - corner
            u = (from_corner * cross).sum(axis=1) / determinant
            other = np.cross(from_corner, first_side)
            v = (ray * other).sum(axis=1) / determinant
            along = other @ second_side / determinant
            hit |= (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0) & (along < 1) & (determinant != 0)
    return hit


@dataclasses.dataclass(frozen=True)
class Light:
    """Rays from each emitter through its slit to its detector, over the workspace: how many, and how many meet a part."""

    rays: int
    blocked: int
    by: tuple[str, ...]


def light(layout: Layout, placed: list[Placed], poses: tuple[Float, Float]) -> Light:
    """Traces the light of every cell past all parts but its own slit, emitter and detector."""
    meshes = [(part, mesh(part.in_place)) for part in placed]
    translation, turned = poses
    total, blocked, by = 0, 0, set()
    for cell in layout.cells:
        rays = layout.rays(cell.number, poses)
        base = [place @ cell.base_from_cell.T + cell.detector for place in (rays.start, rays.end)]
        tool = [np.einsum("ni,nij->nj", place - translation[rays.pose], turned[rays.pose]) for place in base]
        stopped = np.zeros(len(rays.pose), dtype=bool)
        for part, body in meshes:
            if part.instance == cell.number and (is_foil(part.name) or part.name in ("emitter", "detector")):
                continue
            start, end = tool if part.on_tool else base
            hit = hits(start, end, body)
            by |= {part.label} if hit.any() else set()
            stopped |= hit
        total += len(stopped)
        blocked += int(stopped.sum())
    return Light(total, blocked, tuple(sorted(by)))


def thinnest(solid: Part, samples: int = 4000, seed: int = 1) -> float:
    """Least wall of a solid at `samples` places of its surface, mm: the distance to the opposite face."""
    body = mesh(solid)
    places, faces = trimesh.sample.sample_surface(body, samples, seed=seed)
    inward = -body.face_normals[faces]
    start = places + 1e-4 * inward
    least = np.full(len(places), np.inf)
    for triangle, normal in zip(body.triangles, body.face_normals):
        facing = inward @ normal
        height = (triangle[0] - start) @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            along = height / facing
        candidate = np.flatnonzero((facing > WALL_COSINE) & (along > 0) & (along < least))
        if len(candidate):
            at = start[candidate] + along[candidate, None] * inward[candidate]
            sides = [np.cross(triangle[(i + 1) % 3] - triangle[i], at - triangle[i]) @ normal for i in range(3)]
            inside = candidate[(np.array(sides) >= -1e-9).all(axis=0)]
            least[inside] = along[inside]
    return float(least.min()) + 1e-4
