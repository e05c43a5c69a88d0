"""Scenes: the optics of a head, forward and inverse."""

from __future__ import annotations

import dataclasses
import os
import warnings
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from .calibration import Calibration
from .poses import Poses, SlitposeWarning

Float = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Response:
    """What every cell (K) of a head gives at poses (N)."""

    #: (N, K, 2) currents of the electrodes at x = −Lx/2 and +Lx/2, dark current included, A.
    currents_a: Float
    #: (N, K) their sum, A.
    i_o_a: Float
    #: (N, K) position of the light on the detector, m; NaN without light.
    x_a_m: Float
    #: (N, K) solid angle of the spot seen from the emitter, sr.
    solid_angle_sr: Float
    #: (N, K) numbers of :class:`slitpose.CellStatus`.
    status: NDArray[np.uint8]
    #: (N, K) bits of :class:`slitpose.Flag`.
    flags: NDArray[np.uint8]
    #: (N, K) error of the integrals, relative to I_O; NaN where nothing was integrated.
    relative_error: Float


@dataclasses.dataclass(frozen=True, eq=False)
class Derivatives:
    """Photocurrents of every cell (K) at poses (N), and their derivatives."""

    #: (N, K) numbers of :class:`slitpose.CellStatus`.
    status: NDArray[np.uint8]
    #: (N, K, 2) currents without dark current, A.
    photocurrents_a: Float
    #: (N, K, 2, 6) derivatives with respect to (dt, dr), a perturbation in the base frame: A/m, A/rad.
    derivatives: Float


@dataclasses.dataclass(frozen=True, eq=False)
class Bound:
    """What a single frame is worth at poses (N), with the noise of the scene's front end, else of the scene."""

    #: (N, 3) m, the poses.
    translation_m: Float
    #: (N, 3) rotation vectors, rad, or (N, 4) quaternions, as they were given.
    rotation: Float
    #: (N, 6) standard deviations by the Cramér–Rao bound, with what a calibration left open: m, rad; NaN: no pose.
    sigma: Float
    #: (N, 6, 6) the covariance that they belong to.
    covariance: Float
    #: (N,) cells whose whole spot is on the detector.
    lit: NDArray[np.uint16]
    #: (N,) condition number of the scaled normal equations.
    condition: Float
    #: (N,) greatest shift of the pose by one undetected outlier, in its σ.
    unnoticed_sigmas: Float
    #: (N,) full scale over the greatest current of an electrode.
    full_scale: Float
    #: (N,) saturation of a detector over its photocurrent, the least of all cells.
    saturation: Float
    #: (N,) photocurrent over what counts as faint, the least of all cells.
    faint: Float


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture, which notebooks show."""

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg

    def save(self, path: Union[str, os.PathLike[str]]) -> None:
        """Writes it to a file."""
        Path(path).write_text(self.svg, encoding="utf-8")


class Scene:
    """A head: its cells, and what its poses rest on. Poses are given as

    * `translation_m`: (N, 3) or (3,), m;
    * `rotation`: rotation vectors (N, 3) or (3,), rad, or quaternions x, y, z, w, (N, 4) or (4,).
    """

    def __init__(self, native: _native.Scene) -> None:
        self._native = native

    @classmethod
    def open(cls, name: Union[str, os.PathLike[str]]) -> Scene:
        """The scene of a file, or the shipped one of this name: see ``slitpose.SCENES``."""
        return cls(_native.Scene.open(os.fspath(name)))

    @classmethod
    def from_toml(cls, text: str, origin: str = "scene") -> Scene:
        """The scene of this text; `origin` names it in messages."""
        return cls(_native.Scene.from_toml(text, origin))

    def with_calibration(self, calibration: Union[Calibration, str, os.PathLike[str]]) -> Scene:
        """The head of this scene as a calibration, or the one in that file, found it."""
        if not isinstance(calibration, Calibration):
            calibration = Calibration.open(calibration)
        return Scene(self._native.with_calibration(calibration._native))

    @property
    def name(self) -> str:
        """Its name."""
        return self._native.name

    @property
    def toml(self) -> str:
        """The text of its file."""
        return self._native.toml

    @property
    def hash(self) -> int:
        """What tells scenes apart in captures and on boards: FNV-1a, 64 bits, of the text."""
        return self._native.hash

    @property
    def cells(self) -> int:
        """How many cells it has: K."""
        return self._native.cells

    @property
    def is_calibrated(self) -> bool:
        """Whether a calibration says what its parts are."""
        return self._native.is_calibrated

    @property
    def workspace(self) -> Float:
        """(6,) half extents of the box of poses that it is meant for: m, rad."""
        return np.concatenate(self._native.workspace)

    def __repr__(self) -> str:
        return f"<Scene {self.name!r}: {self.cells} cells{', calibrated' if self.is_calibrated else ''}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.toml, self._native.origin, self._calibration())

    def _calibration(self) -> Optional[str]:
        return self._native.calibration

    def model(
        self,
        translation_m: ArrayLike,
        rotation: ArrayLike,
        *,
        tier: Optional[str] = None,
        tolerance: Optional[float] = None,
    ) -> Response:
        """Currents and spots of every cell, as ``slitpose model``.

        :param tier: ``"paper"`` or ``"exact"`` (default); `tolerance`: relative error of the exact tier's integrals, 1e-10
            unless given.
        """
        columns = self._native.model(*_poses(translation_m, rotation), tier=tier, tolerance=tolerance)
        tolerance = columns.pop("tolerance")
        response = Response(**columns)
        inexact = response.relative_error > (np.inf if tolerance is None else tolerance)
        if inexact.any():
            worst = response.relative_error[inexact].max()
            rows = int(inexact.any(axis=1).sum())
            text = f"{rows} rows are good to {worst:.1e} of I_O only: the integrals met a limit; see relative_error"
            warnings.warn(text, SlitposeWarning, stacklevel=2)
        return response

    def derivatives(
        self,
        translation_m: ArrayLike,
        rotation: ArrayLike,
        *,
        tier: Optional[str] = None,
        tolerance: Optional[float] = None,
    ) -> Derivatives:
        """Photocurrents and their analytic derivatives; options as for :meth:`model`."""
        columns = self._native.derivatives(*_poses(translation_m, rotation), tier=tier, tolerance=tolerance)
        return Derivatives(**columns)

    def solve(
        self,
        currents_a: ArrayLike,
        *,
        frames: Optional[ArrayLike] = None,
        tier: Optional[str] = None,
        tolerance: Optional[float] = None,
        without_clipped: bool = False,
        frame: Optional[str] = None,
        tip: Optional[str] = None,
    ) -> Poses:
        """The pose behind each row of currents, each from a cold start, as ``slitpose solve``; on all cores.

        :param currents_a: (N, K, 2) all taken at one instant, dark current included, A; NaN, infinite or masked: not measured.
        :param frames: (N,) or a number: of how many frames a row is the mean; default 1.
        :param tolerance: relative error of the exact tier's integrals, 1e-6 unless given.
        :param frame: as for :func:`slitpose.replay`, and `tip`.
        """
        currents = _floats(currents_a)
        if currents.ndim != 3:
            raise ValueError(f"currents_a has the shape {currents.shape}; give (N, {self.cells}, 2)")
        if frames is not None:
            frames = np.ascontiguousarray(np.broadcast_to(_floats(frames), len(currents)))
        columns = self._native.solve(
            currents, frames, tier=tier, tolerance=tolerance, without_clipped=without_clipped, frame=frame, tip=tip
        )
        return Poses(**columns)

    def crlb(self, translation_m: ArrayLike, rotation: ArrayLike) -> Bound:
        """What a single frame is worth at poses: the Cramér–Rao bound, which solving reaches."""
        translation, turned = _poses(translation_m, rotation)
        return Bound(translation, turned, **self._native.crlb(translation, turned))

    def map(self, samples: int = 20_000) -> Bound:
        """:meth:`crlb` at `samples` poses spread evenly over the workspace, the same ones as ``slitpose scene map``."""
        if samples < 1:
            raise ValueError(f"samples = {samples}; give at least 1")
        poses = self._native.workspace_poses(samples)
        return self.crlb(poses["translation_m"], poses["rotation_rad"])

    def plot(
        self,
        translation_m: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike = (0.0, 0.0, 0.0),
        *,
        cell: Optional[int] = None,
    ) -> Picture:
        """Three views of the head and the light on each detector, at one pose; or one `cell` from the side."""
        return Picture(self._native.plot(*_poses(translation_m, rotation), cell=cell))


def _restored(toml: str, origin: str, calibration: Optional[str]) -> Scene:
    scene = Scene.from_toml(toml, origin)
    return scene if calibration is None else scene.with_calibration(Calibration.from_toml(calibration))


def _floats(values: ArrayLike) -> Float:
    """As an array; NaN where it is masked."""
    return np.ma.asarray(values, dtype=np.float64).filled(np.nan)


def _poses(translation_m: ArrayLike, rotation: ArrayLike) -> tuple[Float, Float]:
    translation, turned = (np.atleast_2d(_floats(values)) for values in (translation_m, rotation))
    for name, array, widths in (("translation_m", translation, (3,)), ("rotation", turned, (3, 4))):
        if array.ndim != 2 or array.shape[1] not in widths:
            shapes = " or ".join(f"(N, {width})" for width in widths)
            raise ValueError(f"{name} has the shape {array.shape}; give {shapes}")
    return translation, turned
