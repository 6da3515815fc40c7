"""Settings of simulated photos: subject, cameras, sensor, pose error."""

import math
from dataclasses import dataclass
from typing import Literal

from geraf2._validation import require_finite, require_positive


@dataclass(frozen=True, kw_only=True)
class PhotosSpec:
    """Photos of the closed outermost box, or of the bare object, taken from rings around it."""

    subject: Literal["box", "content"] = "box"
    """Subject: the closed box, or the object without its box, painted."""
    n_photos: int = 48
    """Photos in all, shared out over the rings."""
    size_px: tuple[int, int] = (640, 480)
    """Width and height of each [pixel]."""
    focal_length_px: float = 640.0
    """Focal length [pixel]."""
    ring_elevations_deg: tuple[float, ...] = (-5.0, 20.0, 45.0)
    """Elevation of each ring from the subject's middle; 3 cm above its lowest point at least
    [degrees]."""
    distance_m: float | None = None
    """Camera to the middle of the subject; by default the subject fills the picture [m]."""
    pose_error_rms_m: float = 0.0002
    """Error of each recorded camera position, per coordinate [m]."""
    pose_error_rms_deg: float = 0.03
    """Error of each recorded orientation, per axis [degrees]."""
    noise_rms: float = 2.0
    """Sensor noise at 18 % grey, which grows as shot noise does, in steps of 1/255."""
    exposure: float = 1.0
    """Gain before the sensor; at 3 the lit faces are over-exposed."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of the lens, as OpenCV's."""
    masks: bool = True
    """Whether silhouettes of the subject are written."""

    def __post_init__(self) -> None:
        if self.n_photos < 1 or min(self.size_px) < 8:
            msg = (
                "photos needs n_photos >= 1 and size_px of at least 8, got "
                f"{self.n_photos} and {self.size_px}"
            )
            raise ValueError(msg)
        if not self.ring_elevations_deg or not all(
            -90.0 < elevation < 90.0 for elevation in self.ring_elevations_deg
        ):
            msg = (
                "photos.ring_elevations_deg must be one angle or more between -90 and 90, got "
                f"{self.ring_elevations_deg}"
            )
            raise ValueError(msg)
        require_positive("photos.focal_length_px", self.focal_length_px)
        require_positive("photos.exposure", self.exposure)
        if self.distance_m is not None:
            require_positive("photos.distance_m", self.distance_m)
        for name in ("pose_error_rms_m", "pose_error_rms_deg", "noise_rms"):
            if not 0.0 <= getattr(self, name) < math.inf:
                msg = f"photos.{name} must be finite and not negative, got {getattr(self, name)}"
                raise ValueError(msg)
        for value in self.distortion:
            require_finite("photos.distortion", value)
