"""Calibrations: the parameters of one head, from measurements on it."""

from __future__ import annotations

import dataclasses
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterable, Optional, Union

from . import _native
from .poses import SlitposeWarning

if TYPE_CHECKING:
    import pandas

    from .scene import Scene

Files = Union[str, "os.PathLike[str]", Iterable[Union[str, "os.PathLike[str]"]]]


@dataclasses.dataclass(frozen=True)
class CellCheck:
    """What readings say of one cell, against what all others predict of it.

    :ivar readings: number of readings.
    :ivar relative: mean deviation of its photocurrent, relative, from that of all cells.
    :ivar position_m: mean deviation of the position of its light, m.
    :ivar rms_position_m: root mean square of that deviation, m.
    :ivar without: χ² over its expectation without the cell.
    """

    readings: int
    relative: float
    position_m: float
    rms_position_m: float
    without: float


@dataclasses.dataclass(frozen=True)
class Check:
    """Whether a calibration still describes its head.

    :ivar rows: rows with a pose.
    :ivar chi2: χ² of all rows over its expectation.
    :ivar light_level: relative deviation of all light together; poses allow for it.
    :ivar is_valid: whether the calibration holds; ``None``: too few rows.
    :ivar changed: the cell that has changed, if only one has.
    :ivar cells: each cell on its own.
    """

    rows: int
    chi2: float
    light_level: float
    is_valid: Optional[bool]
    changed: Optional[int]
    cells: tuple[CellCheck, ...]


class Calibration:
    """The parameters of one head. :meth:`slitpose.Scene.with_calibration` uses it."""

    def __init__(self, native: _native.Calibration, remarks: tuple[str, ...] = ()) -> None:
        self._native = native
        #: What was noticed on the way, with the next step.
        self.remarks = remarks

    @classmethod
    def open(cls, path: Union[str, os.PathLike[str]]) -> Calibration:
        """The calibration of a file."""
        return cls(_native.Calibration.open(Path(path)))

    @classmethod
    def from_toml(cls, text: str, origin: str = "calibration") -> Calibration:
        """The calibration of this text; `origin` names it in messages."""
        return cls(_native.Calibration.from_toml(text, origin))

    @property
    def id(self) -> str:
        """A word that tells calibrations apart."""
        return self._native.id

    @property
    def date(self) -> Optional[str]:
        """When the data were taken, if that is known."""
        return self._native.date

    @property
    def toml(self) -> str:
        """The text of its file, which ``--calibration`` of all commands takes."""
        return self._native.toml

    def save(self, path: Union[str, os.PathLike[str]]) -> None:
        """Writes it to a file."""
        Path(path).write_text(self.toml, encoding="utf-8")

    @property
    def weak(self) -> tuple[str, ...]:
        """What the data left open, in words."""
        return tuple(self._native.weak)

    @property
    def statistics(self) -> dict[str, Any]:
        """How well the data fit: ``rows``, ``readings`` and ``readings_rejected`` of single cells, ``poses_rejected`` of
        the instrument, ``chi2`` and its expectation ``redundancy``; rms distance from the instrument's poses of rows left
        out in turn, ``held_out_m`` and ``held_out_rad``, or ``None``."""
        return self._native.statistics

    @property
    def frames(self) -> list[dict[str, Any]]:
        """Of each instrument with frames of its own: ``file``, ``base_from_reference``, ``tool_from_marker`` (translation
        in m, rotation vector in rad) and their standard deviations."""
        names = ("file", "base_from_reference", "base_from_reference_sigma", "tool_from_marker", "tool_from_marker_sigma")
        return [dict(zip(names, row)) for row in self._native.frames]

    def parameters(self) -> pandas.DataFrame:
        """All parameters: ``cell`` (empty: shared by all), ``quantity``, ``prior`` and ``value`` with their standard
        deviations, in the SI unit of the quantity."""
        import pandas

        names = ["cell", "quantity", "prior", "prior_sigma", "value", "sigma"]
        return pandas.DataFrame(self._native.parameters, columns=names).astype({"cell": "Int64"})

    def check(self, readings: Files) -> Check:
        """Whether it still describes the head that gave these readings of free motion: captures, or tables."""
        found = self._native.check(_list(readings))
        _warn(found.pop("remarks"))
        cells = tuple(CellCheck(*cell) for cell in found.pop("cells"))
        return Check(**found, cells=cells)

    def __repr__(self) -> str:
        return f"<Calibration {self.id}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Calibration.from_toml, (self.toml,)


def calibrate(
    scene: Union[Scene, str, os.PathLike[str]],
    *,
    known: Files = (),
    free: Files = (),
    pivot: Files = (),
    stage: Files = (),
    rest: Files = (),
    own_frames: bool = False,
    known_sigma_m: float = 2e-6,
    known_sigma_rad: float = 20e-6,
    start: Union[Calibration, str, os.PathLike[str], None] = None,
    date: Optional[str] = None,
) -> Calibration:
    """Finds the parameters of a real head from measurements on it, as ``slitpose calibrate``: files, in its units.

    :param scene: the head as designed: a scene, its file, or the name of a shipped one.
    :param known: tables of readings at poses that another instrument measured.
    :param free: captures or tables of free motion.
    :param pivot: captures or tables while one point of the tool rests in a cone.
    :param stage: tables of readings at known steps along a line.
    :param rest: captures or tables of several returns to one pose.
    :param own_frames: the instrument's frame and its marker are at unknown fixed places, not those of the scene.
    :param known_sigma_m: standard deviation of the instrument's positions, each axis, m.
    :param known_sigma_rad: the same of its rotations, rad.
    :param start: an earlier result of the same scene to go on from.
    :param date: day of the measurements, kept in the result.
    :raises slitpose.SlitposeError: data that contradict the scene.
    :warns slitpose.SlitposeWarning: what was noticed on the way.
    """
    from .scene import Scene

    if not isinstance(scene, Scene):
        scene = Scene.open(scene)
    if start is not None and not isinstance(start, Calibration):
        start = Calibration.open(start)
    native, remarks = _native.calibrate(
        scene._native,
        known=_list(known),
        free=_list(free),
        pivot=_list(pivot),
        stage=_list(stage),
        rest=_list(rest),
        own_frames=own_frames,
        known_sigma_m=known_sigma_m,
        known_sigma_rad=known_sigma_rad,
        start=None if start is None else start._native,
        date=date,
    )
    _warn(remarks)
    return Calibration(native, tuple(remarks))


def _list(files: Files) -> list[Path]:
    return [Path(files)] if isinstance(files, (str, os.PathLike)) else [Path(file) for file in files]


def _warn(remarks: Iterable[str]) -> None:
    for text in remarks:
        warnings.warn(text, SlitposeWarning, stacklevel=3)
