"""Pictures of other programs: formats that Pillow itself decodes, of a bounded size."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.regular import BINARY_BYTES, open_regular

PICTURE_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "PPM", "GIF")
"""Without EPS, for which Pillow starts another program, and without rare decoders."""
MAX_PIXELS = 200_000_000
"""Limit of an image; larger sizes are treated as broken or hostile headers."""


@contextmanager
def open_picture(path: Path) -> Iterator[Image.Image]:
    """Open a picture, which is not decoded yet; UserError if it is missing, broken or too large."""
    refuse_other_kind(path, ("image",))
    with ExitStack() as stack:
        try:
            file = stack.enter_context(open_regular(path, BINARY_BYTES))
            image = stack.enter_context(
                Image.open(file, formats=PICTURE_FORMATS)  # noqa: TID251 - only here
            )
        except FileNotFoundError:
            raise UserError(what="no such image", where=path) from None
        except UnidentifiedImageError:
            raise UserError(
                what="the image cannot be read", where=path, expected=", ".join(PICTURE_FORMATS)
            ) from None
        except (OSError, ValueError, SyntaxError) as error:
            raise broken_picture(path, error) from error
        except Image.DecompressionBombError as error:
            raise UserError(what=f"the image is too large: {error}", where=path) from error
        if image.width * image.height > MAX_PIXELS:
            raise UserError(
                what="the image is too large",
                where=path,
                expected=f"at most {MAX_PIXELS} pixels",
                got=f"{image.width} x {image.height}",
            )
        yield image


def broken_picture(path: Path, error: Exception) -> UserError:
    """Error of a picture that cannot be decoded."""
    return UserError(what=f"the image cannot be read ({error})", where=path)
