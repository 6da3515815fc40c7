"""Recogniser of files that are not what their name states: pointers, error pages, archives, ..."""

import re
from collections.abc import Collection
from pathlib import Path

from geraf2.errors import UserError

_HEAD_BYTES = 1024
_UART_HEAD_BYTES = 1 << 16
# What a file begins with, its kind, and what to do.
_KINDS: tuple[tuple[str, bytes, str, str], ...] = (
    (
        "lfs",
        rb"version https://git-lfs",
        "a Git LFS pointer in place of the file",
        "fetch the file with 'git lfs pull'",
    ),
    (
        "annex",
        rb"(\.\./|\.git/|/)*annex/objects/",
        "a git-annex pointer in place of the file",
        "fetch the file with 'git annex get'",
    ),
    (
        "html",
        rb"\s*<(!doctype html|html|head|body|!--)",
        "a web page (HTML), probably of a failed download",
        "download the file itself ('raw')",
    ),
    (
        "html",
        rb"\s*<(\?xml[^>]*>\s*<)?error\b",
        "an error message (XML) of a server",
        "download the file again",
    ),
    ("gzip", rb"\x1f\x8b\x08", "packed with gzip", "unpack it with gunzip"),
    ("zip", rb"PK(\x03\x04|\x05\x06)", "a ZIP archive", "unpack it"),
    ("bzip2", rb"BZh[1-9](1AY&SY|\x17rE8P\x90)", "packed with bzip2", "unpack it with bunzip2"),
    ("xz", rb"\xfd7zXZ\x00", "packed with xz", "unpack it with unxz"),
    ("zstd", rb"\x28\xb5\x2f\xfd", "packed with zstd", "unpack it with unzstd"),
    ("7z", rb"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it"),
    ("rar", rb"Rar!\x1a\x07", "a RAR archive", "unpack it"),
    ("tar", rb".{257}ustar", "a tar archive", "unpack it"),
    (
        "pcap",
        rb"(\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x4d\x3c\xb2\xa1|\x0a\x0d\x0d\x0a.{4}\x4d\x3c\x2b\x1a)",
        "a network capture (pcap)",
        "write the payload of its UDP packets to a file",
    ),
    ("rosbag", rb"#ROSBAG V", "a ROS bag", "export its messages first"),
    ("sqlite", rb"SQLite format 3\x00", "an SQLite database (ROS 2 bag?)", "export its data first"),
    ("pickle", rb"\x80[\x02-\x05](\x95.{8}|[\]\}cX(])", "a Python pickle", "save it as .npy"),
    ("hdf5", rb"(.{512})?\x89HDF\r\n\x1a\n", "an HDF5 file", ""),
    ("mat", rb"MATLAB [57]\.", "a MATLAB file", ""),
    ("npy", rb"\x93NUMPY", "a NumPy array", ""),
    (
        "octave",
        rb"# Created by Octave|Octave-1-[Ll]",
        "a file of Octave, whose formats are not read",
        "save it in Octave with 'save -v7'",
    ),
    ("pdf", rb"%PDF-", "a PDF document", ""),
    ("image", rb"(\x89PNG\r\n|\xff\xd8\xff[\xdb\xe0-\xef]|GIF8[79]a)", "a picture", ""),
)
# The demos of TI send frames of detected points on the serial port; each begins with these bytes.
_UART_MAGIC = b"\x02\x01\x04\x03\x06\x05\x08\x07"


def refuse_other_kind(path: Path, own: Collection[str] = (), *, is_raw: bool = False) -> None:
    """Raise UserError for a file that is plainly of another kind than a reader expects.

    own: kinds that this reader reads, as "zip" or "hdf5".
    is_raw: raw samples are expected: text and output of the serial port are refused as well.
    """
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return
        with path.open("rb") as file:
            head = file.read(_UART_HEAD_BYTES if is_raw else _HEAD_BYTES)
    except (OSError, ValueError):
        return
    for kind, pattern, text, hint in _KINDS:
        if kind not in own and re.match(pattern, head, re.DOTALL | re.IGNORECASE):
            raise UserError(what=f"is {text}", where=path, hint=hint or None)
    if is_raw and _UART_MAGIC in head:
        raise UserError(
            what="is a recording of the serial port of TI's demo (detected points), without raw "
            "samples",
            where=path,
            expected="what the DCA1000 recorded",
        )
    head = head[:_HEAD_BYTES]
    if is_raw and head and re.fullmatch(rb"[\t\n\r -~]+", head):
        what = f"is text, beginning with {head[:40].decode('ascii').splitlines()[0]!r}"
        raise UserError(what=what, where=path, expected="raw samples of 16 bits")
