import numpy as np
import pytest
from PIL import EpsImagePlugin, Image

from geraf2.apps.photos.formats.images import read_image, read_mask, read_size
from geraf2.errors import UserError
from geraf2.io.pictures import PICTURE_FORMATS, open_picture
from geraf2.report.html import picture

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"


@pytest.fixture
def started(monkeypatch):
    """Calls of Ghostscript."""
    calls = []

    def start(*arguments, **_):
        calls.append(arguments)
        return Image.new("RGB", (8, 8)).im

    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", start)
    return calls


@pytest.mark.parametrize("read", [read_image, read_mask, read_size, picture])
@pytest.mark.parametrize("name", ["photo.png", "photo.jpg", "photo.eps"])
def test_postscript_under_any_name_starts_no_program(tmp_path, started, read, name):
    (tmp_path / name).write_bytes(EPS)
    with pytest.raises(UserError, match=f"{name}: the image cannot be read, expected PNG"):
        read(tmp_path / name)
    assert started == []


@pytest.mark.parametrize("kind", PICTURE_FORMATS)
def test_the_formats_of_cameras_and_masks_are_read(tmp_path, kind):
    path = tmp_path / f"photo.{kind.lower()}"
    Image.fromarray(np.full((6, 8, 3), 200, np.uint8)).save(path, format=kind)
    assert read_size(path) == (8, 6)
    assert abs(int(read_image(path).colour[3, 4, 1]) - 200) < 3


def test_a_picture_beyond_the_limit_is_not_decoded(tmp_path, monkeypatch):
    monkeypatch.setattr("geraf2.io.pictures.MAX_PIXELS", 63)
    Image.new("L", (8, 8)).save(tmp_path / "photo.png")
    with (
        pytest.raises(UserError, match=r"too large, expected at most 63 pixels, got 8 x 8"),
        open_picture(tmp_path / "photo.png"),
    ):
        pass
