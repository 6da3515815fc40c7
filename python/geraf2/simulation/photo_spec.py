"""Settings of simulated photos: subject, cameras, sensor, pose error."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, Few, LengthM, MarginM

_SidePx = Annotated[int, Interval(ge=8, le=65_536)]
_ElevationDeg = Annotated[float, Interval(gt=-90.0, lt=90.0)]
_Lens = Annotated[float, Interval(ge=-100.0, le=100.0)]


@dataclass(frozen=True, kw_only=True)
class PhotosSpec(Bounded):
    """Photos of the closed outermost box, or of the bare object, taken from rings around it."""

    subject: Literal["box", "content"] = "box"
    """Subject: the closed box, or the object without its box, painted."""
    n_photos: Few = 48
    """Photos in all, shared out over the rings."""
    size_px: tuple[_SidePx, _SidePx] = (640, 480)
    """Width and height of each [pixel]."""
    focal_length_px: Annotated[float, Interval(gt=0.0, le=1e6)] = 640.0
    """Focal length [pixel]."""
    ring_elevations_deg: Annotated[tuple[_ElevationDeg, ...], MinLen(1)] = (-5.0, 20.0, 45.0)
    """Elevation of each ring from the subject's middle; 3 cm above its lowest point at least
    [degrees]."""
    distance_m: LengthM | None = None
    """Camera to the middle of the subject; by default the subject fills the picture [m]."""
    pose_error_rms_m: MarginM = 0.0002
    """Error of each recorded camera position, per coordinate [m]."""
    pose_error_rms_deg: Annotated[float, Interval(ge=0.0, le=360.0)] = 0.03
    """Error of each recorded orientation, per axis [degrees]."""
    noise_rms: Annotated[float, Interval(ge=0.0, le=255.0)] = 2.0
    """Sensor noise at 18 % grey, which grows as shot noise does, in steps of 1/255."""
    exposure: Annotated[float, Interval(gt=0.0, le=1e3)] = 1.0
    """Gain before the sensor; at 3 the lit faces are over-exposed."""
    distortion: tuple[_Lens, _Lens, _Lens, _Lens, _Lens] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of the lens, as OpenCV's."""
    masks: bool = True
    """Whether silhouettes of the subject are written."""
