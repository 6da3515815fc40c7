"""What every reader of a photo set returns: one record a photo, in one convention."""

from dataclasses import dataclass

from geraf2.io.photo_files import PhotoRecord


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoSource:
    """A photo set as a reader found it, images not yet read."""

    format: str
    """Name of the format."""
    records: tuple[PhotoRecord, ...]
    """One a photo, in the source's order."""
    unit_m: float | None = None
    """Length of the source's unit, where the source says it [m]."""
    frame: str | None = None
    """Name of the frame of the poses, where the source says it."""
    notes: tuple[str, ...] = ()
    """What the user should know."""
