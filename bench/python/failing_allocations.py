"""The n-th allocation of a small run fails, for all n: is it one line, and is nothing lost?

    python bench/python/failing_allocations.py [--min-kb 128] [--every 1] [--first 0]

Every allocation of malloc, C++ and torch is counted that is as large as stated. A trial is a fork
of a process that has run once. It makes one of them fail and asks for
- exit code 2 and one line of error that is no internal one, or 0 where the run did without;
- no folder and no temporary file left where the run failed;
- the same bytes as without the fault, once the run is repeated.
A line a failure, and the counts at the end; exit code 1 if any trial failed. Wants Linux with glibc
and a C compiler. Python keeps its small objects in blocks of its own, which are not counted.
"""

import argparse
import ctypes
import io
import os
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from contextlib import redirect_stdout
from pathlib import Path

from geraf2 import examples
from geraf2.cli.main import main as command_line
from geraf2.scene.store import save_capture

SOURCE = Path(__file__).with_name("failing_malloc.c")
LIBRARY = "GERAF2_FAILING_MALLOC"
COARSE = ["--preset", "fast", "--fit.spacing-m", "0.006"]
COARSE += ["--calibrate", "no", "--trust-los", "--threads", "1", "--no-report", "--quiet"]
RESULTS = ("mesh.ply", "mesh_content.glb", "sdf.npz")


def start_again(folder: str) -> int:
    """This script once more, with the allocations that can be made to fail."""
    library = Path(folder) / "failing_malloc.so"
    compiler = os.environ.get("CC", "cc")
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "-o", library, SOURCE], check=True)
    env = {**os.environ, "LD_PRELOAD": str(library), LIBRARY: str(library)}
    return subprocess.run([sys.executable, *sys.argv], env=env, check=False).returncode


def run(scene: Path, out: Path) -> int:
    box = [str(side) for side in examples.BOX_M]
    return command_line(["reconstruct", str(scene), str(out), "--box", *box, *COARSE])


def wrong(code: int, printed: str, out: Path) -> str:
    """What a run with a fault did wrong; empty where it did nothing."""
    lines = [line for line in printed.splitlines() if "geraf2: " in line]
    if (code, len(lines)) not in ((0, 0), (2, 1)) or "internal error" in printed:
        return f"exit code {code}: {' '.join(lines) or printed[-300:]}"
    if left := list(out.parent.rglob(".*.tmp*")):
        return f"left {left[0].name}"
    if out.exists() == (code != 0):
        return f"exit code {code}, and the folder is {'there' if out.exists() else 'not there'}"
    return ""


def with_fault(scene: Path, whole: Path, out: Path, log: Path, n: int, least: int) -> str:
    """Exit code of a run whose n-th allocation fails, and what is wrong with it."""
    faults = ctypes.CDLL(os.environ[LIBRARY])
    faults.fail_allocation(ctypes.c_long(n), ctypes.c_size_t(least))
    code = run(scene, out)
    faults.stop_failing()
    sys.stderr.flush()
    found = wrong(code, log.read_text(errors="replace"), out)
    if not found and run(scene, out) != 0:
        found = "cannot be repeated"
    if not found and any((out / r).read_bytes() != (whole / r).read_bytes() for r in RESULTS):
        found = "another result"
    return f"{code} {found}"


def trial(scene: Path, whole: Path, folder: Path, n: int, least: int) -> str:
    """In a fork: the n-th allocation fails, then the run is repeated; what is wrong."""
    log, answer, out = folder / "log", folder / "answer", folder / "runs" / "out"
    out.parent.mkdir(parents=True)
    child = os.fork()
    if child == 0:
        with log.open("wb") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        try:
            answer.write_text(with_fault(scene, whole, out, log, n, least))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(0)
    _, status = os.waitpid(child, 0)
    if status or not answer.is_file():
        return f"- ended with status {status}: {log.read_text(errors='replace')[-300:]}"
    return answer.read_text()


def trials(folder: Path, chosen: argparse.Namespace) -> int:
    scene, least = folder / "scene", int(1024 * chosen.min_kb)
    save_capture(examples.small_capture()[0], scene)
    faults = ctypes.CDLL(os.environ[LIBRARY])
    faults.stop_failing.restype = ctypes.c_long
    for name in ("first", "whole"):  # the first one imports what is imported when needed
        faults.fail_allocation(ctypes.c_long(-1), ctypes.c_size_t(least))
        with redirect_stdout(io.StringIO()):
            if run(scene, folder / name) != 0:
                return 2
    n_all, counts, n_failed = faults.stop_failing(), Counter(), 0
    for n in range(chosen.first, n_all, chosen.every):
        code, _, found = trial(scene, folder / "whole", folder / str(n), n, least).partition(" ")
        counts[code] += 1
        if found:
            n_failed += 1
            print(f"{n}: {found}", flush=True)
    print(
        f"{n_all} allocations of {chosen.min_kb:g} kB and more; of these {counts.total()} failed "
        f"once: {counts['2']} with one line, {counts['0']} without effect; {n_failed} wrong"
    )
    return 1 if n_failed else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--min-kb", type=float, default=128.0, help="smallest that fails")
    parser.add_argument("--every", type=int, default=1, help="only every so many")
    parser.add_argument("--first", type=int, default=0, help="number of the first that fails")
    chosen = parser.parse_args()
    if chosen.every < 1 or chosen.first < 0 or chosen.min_kb < 0:
        parser.error("--every is at least 1, --first and --min-kb at least 0")
    if shutil.which(os.environ.get("CC", "cc")) is None:
        parser.error("no C compiler; name one in CC")
    with tempfile.TemporaryDirectory(prefix="allocations-") as folder:
        return trials(Path(folder), chosen) if LIBRARY in os.environ else start_again(folder)


if __name__ == "__main__":
    sys.exit(main())
