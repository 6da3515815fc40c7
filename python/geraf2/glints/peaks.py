"""Local maxima of sub-aperture images, refined below one bin."""

from dataclasses import dataclass

from geraf2._types import Floats
from geraf2.imaging.subapertures import SubapertureImage
from geraf2.ops.subaperture import CosineAxis, SubapertureBins, image_peaks


@dataclass(frozen=True, kw_only=True, eq=False)
class Peaks:
    """Maxima of one sub-aperture image."""

    cosines: Floats
    """Direction cosines along the pose's horizontal and vertical axis, (n_peaks, 2)."""
    ranges_m: Floats
    """One-way distance from the sub-aperture's centre, (n_peaks,) [m]."""
    magnitudes: Floats
    """Amplitude at the maximum, (n_peaks,)."""
    noise: Floats
    """Root mean square of the noise in the peak's range bin, (n_peaks,)."""


def find_peaks(image: SubapertureImage, dynamic_range_db: float, noise_margin_db: float) -> Peaks:
    """Maxima among 26 neighbours, above both thresholds, refined by a parabola per axis.

    Parameters
    ----------
    image
        Range bins at both ends never hold a peak.
    dynamic_range_db
        Peaks weaker than the image's largest by more are dropped [dB].
    noise_margin_db
        Peaks less than this above the noise floor of their range bin are dropped [dB].
    """
    found = image_peaks(
        image.magnitude, image_bins(image), thresholds_db=(dynamic_range_db, noise_margin_db)
    )
    return Peaks(
        cosines=found.cosines,
        ranges_m=found.ranges_m,
        magnitudes=found.magnitudes,
        noise=found.noise,
    )


def image_bins(image: SubapertureImage) -> SubapertureBins:
    """Bins of an image."""
    horizontal, vertical = (
        CosineAxis(count=len(axis), first=float(axis[0]), pitch=_pitch(axis), wraps=wraps)
        for axis, wraps in zip(
            (image.horizontal_cosines, image.vertical_cosines), image.wraps, strict=True
        )
    )
    return SubapertureBins(
        horizontal=horizontal,
        vertical=vertical,
        first_range_m=float(image.ranges_m[0]),
        range_pitch_m=_pitch(image.ranges_m),
        n_ranges=len(image.ranges_m),
    )


def _pitch(axis: Floats) -> float:
    return float(axis[1] - axis[0])
