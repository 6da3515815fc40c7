"""Lock of a folder into which one command at a time writes."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from geraf2.errors import UserError


class BusyFolderError(UserError):
    """Another command writes into the folder."""


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold a folder against other commands; BusyFolderError if one writes into it.

    The lock goes with its process. A network folder without locks is not held.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BusyFolderError(
                what="another command is writing into this folder",
                where=folder,
                got=_holder_of(descriptor),
                hint="wait for it, or choose another folder",
            ) from None
        except OSError:
            pass
        yield
    finally:
        os.close(descriptor)


def _holder_of(descriptor: int) -> str | None:
    """Process that holds a lock; None where the system does not name it."""
    inode = os.fstat(descriptor).st_ino
    with suppress(OSError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()
            if words[1] == "FLOCK" and words[5].endswith(f":{inode}"):
                return f"process {words[4]}"
    return None
