from os import PathLike
from typing import Any, Optional, Sequence, Tuple, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AXES",
    "CELL_STATUSES",
    "COLUMNS",
    "Calibration",
    "Captures",
    "READINGS",
    "SCENES",
    "Scene",
    "SlitposeError",
    "__version__",
    "calibrate",
    "fence",
    "limit_cores",
    "quaternions",
    "rotation_vectors",
]
__version__: str
COLUMNS: list[Tuple[str, str, str, list[str]]]
CELL_STATUSES: list[str]
READINGS: list[str]
AXES: list[str]
SCENES: list[str]

_Float = NDArray[np.float64]
_Path = PathLike[str]
_Columns = dict[str, Any]

class SlitposeError(Exception): ...

@final
class Captures:
    def __new__(
        cls,
        files: Sequence[_Path],
        *,
        scene: Optional[str] = None,
        calibration: Optional[_Path] = None,
        tier: Optional[str] = None,
        tolerance: Optional[float] = None,
        filter_s: Optional[float] = None,
        without_clipped: bool = False,
        known_light: bool = False,
        frame: Optional[str] = None,
        tip: Optional[str] = None,
        from_s: Optional[float] = None,
        to_s: Optional[float] = None,
        duration_s: Optional[float] = None,
        warm_up_s: Optional[float] = None,
        currents: bool = False,
    ) -> Captures: ...
    def read(self, min_rows: Optional[int] = None) -> Optional[_Columns]: ...
    @property
    def devices(self) -> list[str]: ...
    @property
    def edges(self) -> _Columns: ...
    @property
    def remarks(self) -> list[str]: ...
    @property
    def losses(self) -> list[str]: ...
    @property
    def sessions(self) -> list[float]: ...
    @property
    def seams(self) -> list[Tuple[str, Optional[int], Optional[int]]]: ...

@final
class Scene:
    @staticmethod
    def open(name: str) -> Scene: ...
    @staticmethod
    def from_toml(text: str, origin: str) -> Scene: ...
    def with_calibration(self, calibration: Calibration) -> Scene: ...
    @property
    def name(self) -> str: ...
    @property
    def origin(self) -> str: ...
    @property
    def toml(self) -> str: ...
    @property
    def hash(self) -> int: ...
    @property
    def cells(self) -> int: ...
    @property
    def is_calibrated(self) -> bool: ...
    @property
    def calibration(self) -> Optional[str]: ...
    @property
    def workspace(self) -> Tuple[list[float], list[float]]: ...
    def geometry(self) -> _Columns: ...
    def workspace_poses(self, count: int) -> _Columns: ...
    def model(
        self, translation_m: _Float, rotation: _Float, tier: Optional[str] = None, tolerance: Optional[float] = None
    ) -> _Columns: ...
    def derivatives(
        self, translation_m: _Float, rotation: _Float, tier: Optional[str] = None, tolerance: Optional[float] = None
    ) -> _Columns: ...
    def solve(
        self,
        currents_a: _Float,
        frames: Optional[_Float] = None,
        tier: Optional[str] = None,
        tolerance: Optional[float] = None,
        without_clipped: bool = False,
        frame: Optional[str] = None,
        tip: Optional[str] = None,
    ) -> _Columns: ...
    def crlb(self, translation_m: _Float, rotation: _Float) -> _Columns: ...
    def plot(self, translation_m: _Float, rotation: _Float, cell: Optional[int] = None) -> str: ...

@final
class Calibration:
    @staticmethod
    def open(path: _Path) -> Calibration: ...
    @staticmethod
    def from_toml(text: str, origin: str) -> Calibration: ...
    @property
    def id(self) -> str: ...
    @property
    def date(self) -> Optional[str]: ...
    @property
    def toml(self) -> str: ...
    @property
    def weak(self) -> list[str]: ...
    @property
    def statistics(self) -> dict[str, Any]: ...
    @property
    def parameters(self) -> list[Tuple[Optional[int], str, float, float, float, float]]: ...
    @property
    def frames(self) -> list[Tuple[str, list[float], list[float], list[float], list[float]]]: ...
    def check(self, readings: Sequence[_Path]) -> dict[str, Any]: ...

def calibrate(
    scene: Scene,
    *,
    known: Sequence[_Path],
    free: Sequence[_Path],
    pivot: Sequence[_Path],
    stage: Sequence[_Path],
    rest: Sequence[_Path],
    own_frames: bool,
    known_sigma_m: float,
    known_sigma_rad: float,
    start: Optional[Calibration] = None,
    date: Optional[str] = None,
) -> Tuple[Calibration, list[str]]: ...
def fence() -> None: ...
def limit_cores(cores: int) -> None: ...
def rotation_vectors(rotation_xyzw: _Float) -> _Float: ...
def quaternions(rotation_rad: _Float) -> _Float: ...
