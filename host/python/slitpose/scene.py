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
from .captures import _text
from .poses import CellStatus, Poses, SlitposeWarning

Float = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Response:
    """What every cell (K) of a head gives at poses (N).

    :ivar currents_a: (N, K, 2) currents of the electrodes at x = −Lx/2 and +Lx/2, dark current included, A.
    :ivar i_o_a: (N, K) their sum, A.
    :ivar x_a_m: (N, K) position of the light on the detector, m; NaN without light.
    :ivar solid_angle_sr: (N, K) solid angle of the spot seen from the emitter, sr.
    :ivar status: (N, K) numbers of :class:`slitpose.CellStatus`.
    :ivar flags: (N, K) bits of :class:`slitpose.Flag`.
    :ivar relative_error: (N, K) error of the integrals, relative to I_O; NaN where nothing was integrated.
    """

    currents_a: Float
    i_o_a: Float
    x_a_m: Float
    solid_angle_sr: Float
    status: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    relative_error: Float

    def __repr__(self) -> str:
        return f"<Response: {len(self.status)} poses, {self.status.shape[1]} cells>"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Derivatives:
    """Photocurrents of every cell (K) at poses (N), and their derivatives.

    :ivar status: (N, K) numbers of :class:`slitpose.CellStatus`.
    :ivar photocurrents_a: (N, K, 2) currents without dark current, A.
    :ivar derivatives: (N, K, 2, 6) derivatives with respect to (dt, dr), a perturbation in the base frame: A/m, A/rad.
    """

    status: NDArray[np.uint8]
    photocurrents_a: Float
    derivatives: Float

    def __repr__(self) -> str:
        return f"<Derivatives: {len(self.status)} poses, {self.status.shape[1]} cells>"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Bound:
    """What a single frame is worth at poses (N), with the noise of the scene's front end, else of the scene.

    :ivar translation_m: (N, 3) m, the poses.
    :ivar rotation: (N, 3) rotation vectors, rad, or (N, 4) quaternions, as they were given.
    :ivar sigma: (N, 6) standard deviations by the Cramér–Rao bound, with what a calibration left open: m, rad; NaN: no
        pose.
    :ivar covariance: (N, 6, 6) the covariance that they belong to.
    :ivar lit: (N,) cells whose whole spot is on the detector.
    :ivar condition: (N,) condition number of the scaled normal equations.
    :ivar unnoticed_sigmas: (N,) greatest shift of the pose by one undetected outlier, in its σ.
    :ivar full_scale: (N,) full scale over the greatest current of an electrode.
    :ivar saturation: (N,) saturation of a detector over its photocurrent, the least of all cells.
    :ivar faint: (N,) photocurrent over what counts as faint, the least of all cells.
    """

    translation_m: Float
    rotation: Float
    sigma: Float
    covariance: Float
    lit: NDArray[np.uint16]
    condition: Float
    unnoticed_sigmas: Float
    full_scale: Float
    saturation: Float
    faint: Float

    def __repr__(self) -> str:
        return f"<Bound: {len(self.sigma)} poses>"


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
        if len(response.status) and (response.status >= CellStatus.dark).all():
            text = "no cell sees light at any pose; are these metres, and radians or quaternions x, y, z, w?"
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
        frame: Union[str, os.PathLike[str], None] = None,
        tip: Union[str, os.PathLike[str], None] = None,
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
        view = {"frame": _text(frame), "tip": _text(tip)}
        columns = self._native.solve(
            currents, frames, tier=tier, tolerance=tolerance, without_clipped=without_clipped, **view
        )
        poses = Poses(**columns)
        if len(poses) and not poses.has_pose.any():
            text = f"no row leads to a pose ({poses!r}); are the currents amperes, with the electrodes in the last axis?"
            warnings.warn(text, SlitposeWarning, stacklevel=2)
        return poses

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
