"""Large allocations of a run fail once; those of kernels all do (cpp/tests)."""

import shutil
import subprocess
import sys

import pytest

SCRIPT = "bench/python/failing_allocations.py"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.skipif(sys.platform != "linux", reason="needs glibc")
def test_a_failed_allocation_is_one_line_and_the_run_can_be_continued(project_root):
    command = [sys.executable, project_root / SCRIPT, "--every", "48"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    stated = done.stdout.splitlines()[-1]
    assert "0 wrong" in stated
    assert int(stated.split("failed once: ")[1].split()[0]) > 3
