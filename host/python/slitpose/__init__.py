"""slitpose for Python: captures, poses and optics as numpy arrays.

SI units everywhere: metres, radians, amperes, seconds. Poses are ``base_from_tool``, ``p_base = R p_tool + t``;
rotation vectors in radians, quaternions in the order x, y, z, w. Whatever has six components has them in the order
tx, ty, tz, rx, ry, rz. A covariance (6, 6) is that of the perturbation ``t' = t + dt``, ``R' = exp(dr) R`` in the base
frame: m², m·rad, rad². N counts rows, K cells.

>>> import slitpose
>>> scene = slitpose.Scene.open("wide")
>>> response = scene.model([1e-3, 0.0, -2e-3], [0.0, 0.1, 0.0])
>>> poses = scene.solve(response.currents_a)
>>> [float(x) for x in poses.translation_m[0].round(9)]
[0.001, 0.0, -0.002]
"""

from ._native import AXES, SCENES, SlitposeError, __version__, limit_cores
from .calibration import Calibration, CellCheck, Check, calibrate
from .captures import Edges, Scans, edges, open, replay, replay_chunks, series, sessions
from .follow import LivePose, follow
from .parts import Part, SeamError, join, open_seams, replay_part
from .poses import CellStatus, DataLossWarning, Flag, Poses, Reading, Status, SlitposeWarning
from .scene import Bound, Derivatives, Picture, Response, Scene

__all__ = [
    "AXES",
    "SCENES",
    "Bound",
    "Calibration",
    "CellCheck",
    "CellStatus",
    "Check",
    "DataLossWarning",
    "Derivatives",
    "Edges",
    "Flag",
    "LivePose",
    "Part",
    "Picture",
    "Poses",
    "Reading",
    "Response",
    "Scans",
    "Scene",
    "SeamError",
    "SlitposeError",
    "SlitposeWarning",
    "Status",
    "__version__",
    "calibrate",
    "edges",
    "follow",
    "join",
    "limit_cores",
    "open",
    "open_seams",
    "replay",
    "replay_chunks",
    "replay_part",
    "series",
    "sessions",
]
