"""Files are opened only where they are files, and folders of geraf2 hold no links."""

import os
import socket

import pytest

from geraf2.errors import UserError
from geraf2.io.regular import open_regular, read_regular, require_no_links, require_regular


def _socket(path):
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))


MAKERS = {
    "a named pipe": os.mkfifo,
    "a socket": _socket,
    "a device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("read", [open_regular, read_regular, require_regular])
def test_what_is_no_file_is_never_opened(tmp_path, monkeypatch, kind, read):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = tmp_path / "chunk"
    MAKERS[kind](path.relative_to(tmp_path))
    with pytest.raises(UserError, match=f"chunk: is no regular file, got {kind}"):
        read(path)


def test_a_file_is_read_up_to_its_limit_and_also_through_a_link(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_regular(tmp_path / "link", 5) == b"12345"
    with open_regular(str(tmp_path / "file")) as handle:
        assert handle.name == str(tmp_path / "file")
        assert not os.get_inheritable(handle.fileno())
    os.truncate(tmp_path / "file", 2 << 30)
    with pytest.raises(UserError, match="too large, expected at most 1 MiB, got 2048 MiB"):
        read_regular(tmp_path / "file", 1 << 20)


def test_a_file_that_does_not_fit_into_memory_is_refused(tmp_path):
    (tmp_path / "file").touch()
    os.truncate(tmp_path / "file", 1 << 42)
    with pytest.raises(UserError, match="file: the run will not fit into memory"):
        read_regular(tmp_path / "file")


def test_links_are_found_at_any_depth(tmp_path):
    below = tmp_path.joinpath(*["d"] * 200)
    below.mkdir(parents=True)
    (below / "file").touch()
    assert require_no_links(tmp_path) == [below / "file"]
    (below / "link").symlink_to("file")
    with pytest.raises(
        UserError, match="d/link: is a link; put the file or the folder itself there"
    ):
        require_no_links(tmp_path)
