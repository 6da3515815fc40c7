"""Commands in processes of their own, and the processor time that they took."""

import os
import subprocess
import tempfile
from collections.abc import Sequence


def run_measured(command: Sequence[str]) -> tuple[int, str, float]:
    """Run a command -> exit code, what it said on stderr, processor time [s]."""
    with tempfile.TemporaryFile(mode="w+", encoding="utf-8", errors="replace") as said:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said
        )
        try:
            # Not getrusage: it knows all children together, and --jobs runs several.
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            process.wait()
            raise
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return process.returncode, said.read(), usage.ru_utime + usage.ru_stime
