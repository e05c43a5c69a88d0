"""Where the parts of a head are, from its scene: frames of cells, blocks and emitters, and the light between them.

Lengths are millimetres. ``base_from_block`` reads: a point of the block, in the base frame. A block's frame has its
origin at the centre of the detector's active area, z along the detector's normal, y along the projected z of the base.
The cell's own frame is the block's, turned about z by `roll`.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from typing import Optional

import numpy as np
from numpy.typing import NDArray

from .. import Scene
from .sizes import ExportError, Sizes

Float = NDArray[np.float64]

#: Greatest component of a normal or an emitter's axis along the base's z, and greatest tilt of a slit, rad.
MAX_OFF_LEVEL = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Cell:
    """One cell of the scene, the tool at home.

    :ivar detector: centre of the active area, base frame.
    :ivar base_from_block: rotation; columns are the block's axes.
    :ivar roll: from the block's x to the detector's length, rad.
    :ivar area: length and width of the active area.
    :ivar slit: width (along the detector's length) and length.
    :ivar offset: centre of the slit, in the cell's x and y.
    :ivar distance: from the active surface to the mask's mid-plane.
    :ivar thickness: of the mask.
    :ivar emitter: tool frame.
    :ivar tool_from_emitter: rotation; z is the emitter's axis, y along the projected z of the tool.
    """

    number: int
    detector: Float
    base_from_block: Float
    roll: float
    area: tuple[float, float]
    slit: tuple[float, float]
    offset: tuple[float, float]
    distance: float
    thickness: float
    emitter: Float
    tool_from_emitter: Float

    @property
    def seat(self) -> float:
        """Height of the mask's seat above the active surface."""
        return self.distance - self.thickness / 2

    @property
    def base_from_cell(self) -> Float:
        """Rotation; columns are the axes of the cell: along the detector, across it, its normal."""
        return self.base_from_block @ about_z(self.roll)

    @property
    def mask_variant(self) -> tuple[float, ...]:
        """What makes the masks, and their frames, of two cells the same part."""
        numbers = (*self.slit, *self.offset, self.distance, self.thickness)
        return tuple(round(number, 9) + 0.0 for number in numbers)

    @property
    def block_variant(self) -> tuple[float, ...]:
        """What makes the blocks of two cells the same part."""
        return (*self.mask_variant, *(round(number, 9) + 0.0 for number in (self.roll, *self.area)))


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Straight rays in a cell's frame, mm.

    :ivar start: (N, 3) the emitter.
    :ivar end: (N, 3) a place on the active area.
    :ivar pose: (N,) the number of the pose.
    """

    start: Float
    end: Float
    pose: NDArray[np.intp]


def about_z(angle: float) -> Float:
    """The rotation about z."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


@dataclasses.dataclass(frozen=True, eq=False)
class Layout:
    """A head that a ring can hold.

    :ivar workspace: half extents of the poses that the head is meant for: mm, and rad of the rotation vector.
    :ivar emitter_part, detector_part: as the scene names them.
    """

    scene: Scene
    cells: list[Cell]
    workspace: Float
    emitter_part: str
    detector_part: str

    @classmethod
    def of(cls, scene: Scene, sizes: Sizes) -> Layout:
        """The cells of `scene`.

        :raises ExportError: The scene is not a ring of detectors behind slits on the base.
        """
        found = scene._native.geometry()
        for number, opening in enumerate(found["opening"]):
            if opening != "a slit on the base":
                text = f"cell {number} of {scene.name!r} has {opening}; this housing holds masks with slits on the base"
                raise ExportError(f"{text}: choose another scene (wide, fine, redundant, base, orderable)")
        if scene.cells < 3:
            text = f"{scene.name!r} has {scene.cells} cells; a ring needs at least 3 around the tool"
            raise ExportError(f"{text}: choose another scene (wide, fine, redundant, base, orderable)")
        for number in range(scene.cells):
            where = f"cell {number} of {scene.name!r}"
            for key, place, outward in (("normal", "detector_m", -1.0), ("emitter_axis", "emitter_m", 1.0)):
                along_z = float(found[key][number][2])
                if abs(along_z) > MAX_OFF_LEVEL:
                    text = f"{where}: {key} has the component {along_z:.6f} along z"
                    raise ExportError(f"{text}; the ring's flats are vertical: it must be 0")
                if outward * (found[key][number] @ found[place][number]) <= 0.0:
                    wrong = "away from" if outward < 0.0 else "towards"
                    text = f"{where}: {key} points {wrong} the z axis"
                    raise ExportError(f"{text}; detectors must face the axis, and emitters the detectors: reverse it")
            tilt = np.degrees(found["slit_tilt_rad"][number])
            if np.abs(tilt).max() > np.degrees(MAX_OFF_LEVEL):
                text = f"{where}: slit.tilt_deg = [{', '.join(f'{number:g}' for number in tilt)}]"
                raise ExportError(
                    f"{text}; masks lie parallel to the detector, their slits across its length: it must be 0. To turn"
                    " a slit about the normal, turn its detector with it (x_axis)"
                )
        document = tomllib.loads(scene.toml)
        return cls(
            scene=scene,
            cells=[_cell(found, number, sizes) for number in range(scene.cells)],
            workspace=scene.workspace * np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0]),
            emitter_part=document.get("emitter", {}).get("part", "not named"),
            detector_part=document.get("detector", {}).get("part", "not named"),
        )

    def poses(self, count: int) -> tuple[Float, Float]:
        """Translations (N, 3), mm, and rotation matrices (N, 3, 3), spread evenly over the workspace; the first is home."""
        found = self.scene._native.workspace_poses(max(count - 1, 1))
        translation = np.concatenate([np.zeros((1, 3)), found["translation_m"] * 1e3])[:count]
        turned = np.concatenate([np.zeros((1, 3)), found["rotation_rad"]])[:count]
        return translation, np.array([rotation(vector) for vector in turned])

    def rays(self, number: int, poses: tuple[Float, Float], across: int = 13) -> Rays:
        """Light that reaches the detector of cell `number` through its slit."""
        cell = self.cells[number]
        translation, turned = poses
        emitters = (translation + turned @ cell.emitter - cell.detector) @ cell.base_from_cell
        x, y = (np.linspace(-extent / 2, extent / 2, points) for extent, points in zip(cell.area, (across, 3)))
        places = np.stack([*map(np.ravel, np.meshgrid(x, y)), np.zeros(3 * across)], axis=1)
        start = np.repeat(emitters, len(places), axis=0)
        end = np.tile(places, (len(emitters), 1))
        passes = np.ones(len(start), dtype=bool)
        for height in (cell.seat, cell.seat + cell.thickness):
            at = end + (start - end) * (height / start[:, 2])[:, None]
            passes &= (np.abs(at[:, :2] - cell.offset) <= np.array(cell.slit) / 2).all(axis=1)
        pose = np.repeat(np.arange(len(emitters)), len(places))
        return Rays(start[passes], end[passes], pose[passes])


def rotation(vector: Float) -> Float:
    """The rotation matrix of a rotation vector, rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross))


def _upright(normal: Float) -> Float:
    """Axes with this z, and y along the z of the frame it is given in."""
    y = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, normal), y, normal], axis=1)


def _cell(found: dict[str, Float], number: int, sizes: Sizes) -> Cell:
    def pair(key: str) -> tuple[float, float]:
        first, second = found[key][number] * 1e3
        return float(first), float(second)

    block = _upright(found["normal"][number])
    along = block.T @ found["x_axis"][number]
    thickness: Optional[float] = float(found["mask_thickness_m"][number]) * 1e3 or None
    return Cell(
        number=number,
        detector=found["detector_m"][number] * 1e3,
        base_from_block=block,
        roll=math.atan2(along[1], along[0]),
        area=pair("active_area_m"),
        slit=pair("slit_m"),
        offset=pair("slit_offset_m"),
        distance=float(found["slit_distance_m"][number]) * 1e3,
        thickness=thickness or sizes.mask.thickness,
        emitter=found["emitter_m"][number] * 1e3,
        tool_from_emitter=_upright(found["emitter_axis"][number]),
    )
