"""Sizes of bought parts, walls, fits and screws from which housings and jigs are made.

Lengths are millimetres, as in drawings. Sizes of bought parts are those of their data sheets, or "assumed": no drawing of
the maker was at hand, so compare them with the part before ordering, and give the correct ones in a file for ``--sizes``.
All others are choices of this design.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Any, TypeVar


class ExportError(Exception):
    """A head that cannot be made, or a file that cannot be read: with the value, the place and the next step."""


@dataclasses.dataclass(frozen=True)
class Detector:
    """The package of the position-sensitive detector. Its top face, around the window, rests on a shoulder."""

    part: str = "S3932"  # Hamamatsu, KPSD1002E
    length: float = 16.0  # assumed
    width: float = 5.0  # assumed
    height: float = 1.8  # assumed
    surface_depth: float = 0.6  # from the top face down to the active surface, assumed
    clearance: float = 0.1  # on each side in its pocket


@dataclasses.dataclass(frozen=True)
class Emitter:
    """The emitter and the small board that carries it."""

    part: str = "VSMY1850"  # Vishay, 83397 rev. 1.5: 2 x 1.25 x 0.85
    length: float = 2.0  # along the base's z
    width: float = 1.25
    height: float = 0.85
    source_height: float = 0.4  # chip above the board, assumed
    source_size: float = 0.3  # of the chip, assumed
    board_width: float = 5.0
    board_length: float = 12.0
    board_thickness: float = 1.0
    screw_distance: float = 4.2  # M1.6, from the emitter
    thread_depth: float = 3.5  # M1.6, in the carrier
    screw_head: float = 1.0  # height, ISO 1580
    pocket_depth: float = 0.5  # of the board's pocket, which locates it
    clearance: float = 0.05  # on each side in its pocket


@dataclasses.dataclass(frozen=True)
class Block:
    """The cell block: a barrel in the ring's bore, which holds mask and detector at their distance."""

    barrel_radius: float = 8.0
    bore_clearance: float = 0.05  # on the radius, between barrel and ring
    flange_half_width: float = 9.4
    flange_half_height: float = 15.0
    shoulder: float = 1.0  # flange above the detector's shoulder
    board_gap: float = 0.2  # between flange and board: the board presses the detector on its shoulder
    chamber_clearance: float = 0.5  # around the light, on the radius
    slot_clearance: float = 0.3  # around the light, on each side
    plate: float = 1.5  # that carries the mask
    ring_screw: float = 11.4  # M2.5, from the middle, along z
    corner: float = 6.5  # M2 and dowel, beside the M2.5
    dowel_depth: float = 2.5  # in the ring
    board_thickness: float = 1.6
    cover_height: float = 6.5
    cover_wall: float = 1.2


@dataclasses.dataclass(frozen=True)
class Mask:
    """The slit mask, and the frame and pins that hold it."""

    thickness: float = 0.1  # if the scene has no `slit.thickness_mm`: etched or laser-cut foil
    radius: float = 7.4
    pin_distance: float = 5.9  # from the middle, along the detector
    pin_diameter: float = 1.0
    pin_length: float = 4.0  # ISO 2338
    frame_radius: float = 7.8
    frame_thickness: float = 0.8
    slit_width_tolerance: float = 0.012  # both ways: etched or laser-cut foil
    slit_position_tolerance: float = 0.02  # against the pins


@dataclasses.dataclass(frozen=True)
class Ring:
    """The base ring and the plate under it."""

    half_height: float = 16.0
    plate_thickness: float = 6.0
    plate_margin: float = 9.0  # beyond the ring's corners
    plate_screw_margin: float = 5.0  # M4, from the plate's edge
    corner_depth: float = 9.0  # of the M3 threads in the ring


@dataclasses.dataclass(frozen=True)
class Tool:
    """The emitter carrier, its handle and its tip."""

    half_height: float = 9.0
    bore_radius: float = 3.0
    wire_hole_diameter: float = 2.6
    wire_hole_distance: float = 1.2
    screw_radius: float = 7.2  # M2, of handle and tip
    thread_depth: float = 3.0  # of these, in the carrier
    flange_radius: float = 9.4
    flange_thickness: float = 3.0
    handle_radius: float = 5.0
    handle_top: float = 60.0  # z
    tip_radius: float = 3.0
    tip_z: float = -40.0  # centre of the ball
    tip_ball_radius: float = 1.5


@dataclasses.dataclass(frozen=True)
class Jig:
    """Deck, nest, ball plate and foot for calibration without an instrument."""

    ball_radius: float = 3.0  # steel, G10, bonded
    ball_circle: float = 26.0  # radius on which the balls are
    vee_depth: float = 3.2  # of the apex below the nest's top
    deck_thickness: float = 6.0
    deck_radius: float = 44.0
    nest_thickness: float = 8.0
    nest_radius: float = 33.0
    nest_flat: float = 30.0  # of fence and stop, from the axis
    ball_plate_thickness: float = 6.0
    ball_plate_radius: float = 31.0
    ball_plate_gap: float = 2.0  # above the nest
    opening: float = 3.0  # around the handle, on the radius
    block: float = 5.0  # gauge block with the tool at home
    steps: float = 3.0  # greatest, both ways
    pin_radius: float = 2.0  # dowels, of fence and stop
    pin_height: float = 6.0  # above the deck
    fence_spread: float = 16.0  # of its two pins, from the middle
    foot_thickness: float = 6.0
    foot_boss_radius: float = 8.0
    foot_boss_min_height: float = 8.0
    cone_half_angle_deg: float = 45.0
    cone_drop: float = 0.2  # of the boss below the ball's middle
    clamp_clearance: float = 0.05  # around the handle, on the radius


@dataclasses.dataclass(frozen=True)
class Sizes:
    """All sizes."""

    detector: Detector = Detector()
    emitter: Emitter = Emitter()
    block: Block = Block()
    mask: Mask = Mask()
    ring: Ring = Ring()
    tool: Tool = Tool()
    jig: Jig = Jig()

    @classmethod
    def open(cls, path: Path | None) -> Sizes:
        """The sizes above, with those that a TOML file gives instead, such as ``detector.length = 16.2``.

        :raises ExportError: The file cannot be read, or has a key that is not a size, or a value that no size can have.
        """
        if path is None:
            return cls()
        try:
            given = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ExportError(f"{path}: {error}; give a TOML file of sizes, such as: detector.length = 16.2") from error
        return _replaced(cls(), given, str(path))


Group = TypeVar("Group")


def _replaced(group: Group, given: dict[str, Any], place: str) -> Group:
    fields = {field.name: getattr(group, field.name) for field in dataclasses.fields(group)}  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for key, value in given.items():
        if key not in fields:
            raise ExportError(f"{place}: there is no size {key!r}; there are {', '.join(fields)}")
        present = fields[key]
        if dataclasses.is_dataclass(present) and isinstance(value, dict):
            changes[key] = _replaced(present, value, f"{place}, {key}")
        elif isinstance(present, str) and isinstance(value, str):
            changes[key] = value
        elif isinstance(present, float) and isinstance(value, (int, float)) and not isinstance(value, bool):
            if not math.isfinite(value) or value * present <= 0.0:
                sign = "positive" if present > 0.0 else "negative"
                raise ExportError(f"{place}: {key} = {value} must be {sign} and finite, such as {present:g}")
            changes[key] = float(value)
        else:
            raise ExportError(f"{place}: {key} = {value!r} has the wrong type; give one such as {present!r}")
    return dataclasses.replace(group, **changes)  # type: ignore[type-var]
