"""Captures: poses solved again, photocurrents, and edges of trigger inputs."""

from __future__ import annotations

import dataclasses
import os
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Iterable, Iterator, Mapping, Optional, Sequence, TypedDict, Union

import numpy as np
from numpy.typing import NDArray

from . import _native
from .poses import DataLossWarning, Poses, SlitposeWarning

if TYPE_CHECKING:
    from typing_extensions import Unpack

Paths = Union[str, "os.PathLike[str]", Iterable[Union[str, "os.PathLike[str]"]]]

#: Rows of a chunk: some 60 MB.
CHUNK = 100_000


class PartOptions(TypedDict, total=False):
    """The options of :func:`replay` that do not say where to begin and end."""

    scene: Union[str, os.PathLike[str], None]
    calibration: Union[str, os.PathLike[str], None]
    tier: Optional[str]
    tolerance: Optional[float]
    filter_s: Optional[float]
    without_clipped: bool
    known_light: bool
    frame: Union[str, os.PathLike[str], None]
    tip: Union[str, os.PathLike[str], None]
    duration_s: Optional[float]


class Options(PartOptions, total=False):
    """The options of :func:`replay`."""

    from_s: Optional[float]
    to_s: Optional[float]


def series(folder: Union[str, os.PathLike[str]]) -> list[list[Path]]:
    """The captures of a folder: files ``NAME.mcap``, and series ``NAME-0001.mcap``, ``NAME-0002.mcap``, …, each in order."""
    found: dict[str, list[tuple[int, Path]]] = {}
    for path in sorted(Path(folder).glob("*.mcap")):
        numbered = re.fullmatch(r"(.+)-(\d{4,})", path.stem)
        stem, number = (numbered[1] + "-", int(numbered[2])) if numbered else (path.stem, 0)
        found.setdefault(stem, []).append((number, path))
    if not found:
        raise FileNotFoundError(f"{folder} holds no file *.mcap; give a folder with captures")
    return [[path for _, path in sorted(files)] for files in found.values()]


def _files(paths: Paths) -> list[Path]:
    """The files of one recording."""
    if not isinstance(paths, (str, os.PathLike)):
        files = [Path(path) for path in paths]
    elif Path(paths).is_dir():
        recordings = series(paths)
        if len(recordings) > 1:
            names = ", ".join(files[0].name for files in recordings)
            raise ValueError(f"{paths} holds {len(recordings)} recordings, which begin with {names}; give one of them")
        files = recordings[0]
    else:
        files = [Path(paths)]
    if not files:
        raise ValueError("no file; give at least one capture")
    return files


def replay(
    paths: Paths,
    *,
    scene: Union[str, os.PathLike[str], None] = None,
    calibration: Union[str, os.PathLike[str], None] = None,
    tier: Optional[str] = None,
    tolerance: Optional[float] = None,
    filter_s: Optional[float] = None,
    without_clipped: bool = False,
    known_light: bool = False,
    frame: Union[str, os.PathLike[str], None] = None,
    tip: Union[str, os.PathLike[str], None] = None,
    from_s: Optional[float] = None,
    to_s: Optional[float] = None,
    duration_s: Optional[float] = None,
) -> Poses:
    """Solves a recording again: the same bits as ``slitpose replay`` with the same options.

    `paths`: a capture, the files of a series in their order, or a folder with one recording. Scene, calibration, equations
    and filter are those of the recording unless given.

    :param scene: scene file, or the name of a shipped scene.
    :param calibration: calibration file, as :meth:`slitpose.Calibration.save` writes it, or ``"none"``: the head is as its
        scene says.
    :param tier: ``"paper"`` or ``"exact"``; `tolerance`: relative error of the exact tier's integrals.
    :param filter_s: memory of the filter, s; 0: no filter.
    :param without_clipped: leave out cells whose light falls on an end of the detector.
    :param known_light: take emitters for as bright as scene or calibration says.
    :param frame: file or name of a frame that poses, velocities and truth are given in; `tip`: point of the tool, a file or
        ``"x,y,z"`` in mm. As for the command.
    :param from_s: begin this long after the beginning of the first file, s; the first poses are then found from nothing,
        unlike in the whole. For parts that are to be joined see :func:`slitpose.replay_part`.
    :param to_s: end this long after the beginning, s.
    :param duration_s: end after so much of the board's time, s.
    :raises slitpose.SlitposeError: a file that cannot be read, or a board that does not suit the scene.
    :warns slitpose.DataLossWarning: data were damaged or lost; :attr:`Poses.losses` says what.

    Some 0.6 kB of memory a scan; :func:`replay_chunks` holds a chunk at a time.
    """
    options = {name: value for name, value in locals().items() if name != "paths"}
    captures = _native.Captures(_files(paths), **_native_options(options))
    columns = captures.read() or {}
    losses, remarks = tuple(captures.losses), tuple(captures.remarks)
    _warn(remarks, losses)
    return Poses(**columns, devices=tuple(captures.devices), losses=losses, remarks=remarks)


def replay_chunks(paths: Paths, rows: int = CHUNK, **options: Unpack[Options]) -> Iterator[Poses]:
    """The poses of :func:`replay`, at least `rows` at a time (the last ones fewer); takes its options.

    The same bits, in bounded memory. Losses are known, and warned of, with the last chunk.
    """
    if rows < 1:
        raise ValueError(f"rows = {rows}; give at least 1")
    captures = _native.Captures(_files(paths), **_native_options(options))
    said = 0
    while (columns := captures.read(rows)) is not None:
        losses, remarks = tuple(captures.losses), tuple(captures.remarks[said:])
        said = len(captures.remarks)
        _warn(remarks, ())
        yield Poses(**columns, devices=tuple(captures.devices), losses=losses, remarks=remarks)
    _warn((), tuple(captures.losses))


def sessions(paths: Paths) -> list[float]:
    """When sessions began in a recording, seconds after its beginning, but for the first of each board; unsolved, so quick.

    A session begins when a link was opened anew, or the board got another configuration. Nothing before it matters to the
    poses: that is where a recording can be split into parts for :func:`slitpose.replay_part`.
    """
    captures = _read_to_end(paths)
    return sorted(captures.sessions)


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Edges:
    """The edges of the boards' trigger inputs in a recording, a row each (N).

    :ivar device: (N,) the board: index of :attr:`devices`.
    :ivar number: (N,) number of the edge, counted by the board; a gap shows edges that were dropped on their way.
    :ivar time_s: (N,) its instant by the board's clock, that of the poses, s.
    :ivar host_utc_ns: (N,) the same by UTC, ns since 1970; 0 while unknown.
    :ivar is_high: (N,) whether the line has risen.
    :ivar missed: (N,) edges up to then that came too fast for the board, at least.
    :ivar devices: the boards: 24 hexadecimal digits each.
    """

    device: NDArray[np.uint8]
    number: NDArray[np.uint32]
    time_s: NDArray[np.float64]
    host_utc_ns: NDArray[np.uint64]
    is_high: NDArray[np.bool_]
    missed: NDArray[np.uint32]
    devices: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"<Edges: {len(self)} rows>"


def edges(paths: Paths) -> Edges:
    """The edges of the boards' trigger inputs in a recording; `paths` as for :func:`replay`. Nothing is solved.

    :raises slitpose.SlitposeError: a file that cannot be read.
    :warns slitpose.DataLossWarning: data were damaged or lost.
    """
    captures = _read_to_end(paths)
    _warn(tuple(captures.remarks), tuple(captures.losses))
    return Edges(**captures.edges, devices=tuple(captures.devices))


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Scans:
    """The raw scans of a recording, a row each (N), of K cells.

    :ivar device: (N,) the board: index of :attr:`devices`.
    :ivar sequence: (N,) number of the scan, counted by the board.
    :ivar time_s: (N,) the instant that a pose of the scan would have, by the board's clock, s.
    :ivar host_utc_ns: (N,) the same by UTC, ns since 1970; 0 while unknown.
    :ivar currents_a: (N, K, 2) photocurrents above dark at nominal emitter drive, A; NaN where a cell was not measured.
        The cells are exposed one after the other, so those of a moving tool belong to slightly different instants.
    :ivar reading: (N, K) numbers of :class:`slitpose.Reading`.
    :ivar devices: the boards: 24 hexadecimal digits each.
    :ivar losses: what was damaged or lost, in words; empty: nothing.
    :ivar remarks: what else was remarkable.
    """

    device: NDArray[np.uint8]
    sequence: NDArray[np.uint64]
    time_s: NDArray[np.float64]
    host_utc_ns: NDArray[np.uint64]
    currents_a: NDArray[np.float64]
    reading: NDArray[np.uint8]
    devices: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"<Scans: {len(self)} rows of {self.currents_a.shape[1]} cells>"


def open(
    paths: Paths,
    *,
    scene: Union[str, os.PathLike[str], None] = None,
    from_s: Optional[float] = None,
    to_s: Optional[float] = None,
    duration_s: Optional[float] = None,
) -> Scans:
    """The raw scans of a recording, unsolved; `paths` and options as for :func:`replay`.

    :raises slitpose.SlitposeError: a file that cannot be read, or a board that does not suit the scene.
    :warns slitpose.DataLossWarning: data were damaged or lost; :attr:`Scans.losses` says what.
    """
    options: Options = {"scene": scene, "from_s": from_s, "to_s": to_s, "duration_s": duration_s}
    captures = _native.Captures(_files(paths), **_native_options(options), currents=True)
    columns = captures.read() or {}
    losses, remarks = tuple(captures.losses), tuple(captures.remarks)
    _warn(remarks, losses)
    return Scans(**columns, devices=tuple(captures.devices), losses=losses, remarks=remarks)


def _read_to_end(paths: Paths) -> _native.Captures:
    """Captures read through, unsolved, for what they have besides rows."""
    captures = _native.Captures(_files(paths), currents=True)
    while captures.read(CHUNK) is not None:
        pass
    return captures


def _native_options(options: Mapping[str, Any]) -> dict[str, Any]:
    unknown = options.keys() - Options.__annotations__.keys()
    if unknown:
        raise TypeError(f"{sorted(unknown)} are no options of replay; it has {', '.join(Options.__annotations__)}")
    texts = {name: _text(options.get(name)) for name in ("scene", "frame", "tip")}
    calibration = options.get("calibration")
    return {**options, **texts, "calibration": None if calibration is None else Path(calibration)}


def _text(path: Union[str, os.PathLike[str], None]) -> Optional[str]:
    return None if path is None else os.fspath(path)


def _warn(remarks: Sequence[str], losses: Sequence[str]) -> None:
    """At the line that calls the caller."""
    for text in remarks:
        warnings.warn(text, SlitposeWarning, stacklevel=3)
    for text in losses:
        warnings.warn(text, DataLossWarning, stacklevel=3)
