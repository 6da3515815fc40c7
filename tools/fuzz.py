"""Coverage-guided fuzzing of the readers: `make fuzz SECONDS=600`, or `--runs 5000`.

Wants the package atheris (dependency group `fuzz`). Each reader gets its share of the time in a
process of its own. What it finds is put into tests/fuzzing/crashes, where the tests replay it; mend
the reader, keep the file. Executions of all calls are counted in tests/fuzzing/executions.json.
With --runs all readers share one process and one seed of random numbers, so that the same code is
given the same data: what CI asks for.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import traceback
import warnings
import zlib
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent / "tests"
HERE = TESTS / "fuzzing"
sys.path[:0] = [str(TESTS), str(TESTS.parent / "bench" / "photos")]
EXECUTIONS = HERE / "executions.json"
TOGETHER = "together"
LARGEST = 9000
"""Bytes of data that are kept: no file of the corpus is larger than 10 kB."""


def fuzz_one(name, arguments):
    """Fuzz one reader until libFuzzer's arguments say that it is enough; all for TOGETHER."""
    import atheris  # noqa: PLC0415 - only this command needs it

    warnings.simplefilter("ignore")
    packages = ["geraf2.io", "geraf2.scene", "tomllib", "trimesh.exchange"]
    with atheris.instrument_imports(include=packages):
        from fuzzing import readers  # noqa: PLC0415 - instrumented
    from geraf2.errors import UserError  # noqa: PLC0415

    seen, names = set(), [*readers.PARTS] if name == TOGETHER else [name]

    def one(data):
        name = names[0]
        if len(names) > 1:
            name, data = names[data[0] % len(names) if data else 0], data[1:]
        try:
            readers.read(name, data)
        except UserError as error:
            if "\n" in str(error):
                found_one(name, data, error, "the message is not one line")
        except Exception as error:
            found_one(name, data, error, str(error))

    def found_one(name, data, error, what):
        """Keep the first data with this failure, and continue."""
        frame = traceback.extract_tb(error.__traceback__)[-1]
        kind = f"{name}, {type(error).__name__} at {Path(frame.filename).name}:{frame.lineno}"
        if kind not in seen:
            seen.add(kind)
            number = f"{zlib.crc32(data):08x}"
            crash = HERE / "crashes" / name
            crash.mkdir(parents=True, exist_ok=True)
            (crash / number).write_bytes(data)
            print(f"finding: {kind}: {what[:200]!r}: {number}", file=sys.stderr)

    found = Path(tempfile.gettempdir()) / "found"
    found.mkdir()
    for index, reader in enumerate(names):
        first = bytes([index]) if len(names) > 1 else b""
        kept = (path.read_bytes() for path in sorted((HERE / "corpus" / reader).glob("*")))
        for number, seed in enumerate([*readers.seeds(reader), *kept]):
            (found / f"good{index:02d}-{number:03d}").write_bytes(first + seed)
    folders = [str(found)] + ([str(HERE / "crashes" / name)] if len(names) == 1 else [])
    for folder in folders:
        Path(folder).mkdir(parents=True, exist_ok=True)
    atheris.Setup([sys.argv[0], *arguments, *folders], one)
    atheris.Fuzz()


def fuzz_all(enough, names, keep=0):
    """Fuzz readers one after the other until libFuzzer's flags say so; the number of findings."""
    total, findings = 0, 0
    for name in names:
        crashes = HERE / "crashes" / name
        crashes.mkdir(parents=True, exist_ok=True)
        flags = [*enough, f"-artifact_prefix={crashes}/", "-timeout=20"]
        flags += ["-rss_limit_mb=4096", "-print_final_stats=1"]
        command = [sys.executable, __file__, "--reader", name, *flags]
        # libFuzzer leaves without cleaning up; a file a run is quickest in memory.
        base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        with tempfile.TemporaryDirectory(dir=base) as scratch:
            done = subprocess.run(
                command,
                check=False,
                capture_output=True,
                text=True,
                env={**os.environ, "TMPDIR": scratch},
            )
            _keep(Path(scratch) / "found", HERE / "corpus" / name, keep)
        found = re.search(r"number_of_executed_units: (\d+)|Done (\d+) runs", done.stderr)
        n = int(next(filter(None, found.groups()))) if found else 0
        # libFuzzer reports what ends the process (crash, 20 s, 4 GiB); the rest is reported above.
        lines = re.findall(r"^(?:finding: |.*ERROR: libFuzzer).*$", done.stderr, re.MULTILINE)
        total, findings = total + n, findings + len(lines)
        so_far = _count(name, n)
        text = f"{name:<12} {n:>9} executions, {so_far.get(name, 0):>9} so far"
        print("\n    ".join([text, *lines]), flush=True)
    so_far = sum(_count().values())
    print(f"{'all':<12} {total:>9} executions, {so_far:>9} so far; {findings} findings")
    return findings


def _count(name=None, n=0):
    """Add executions of a reader to those so far; returns all."""
    counts = json.loads(EXECUTIONS.read_text(encoding="ascii")) if EXECUTIONS.exists() else {}
    if n:
        counts[name] = counts.get(name, 0) + n
        EXECUTIONS.write_text(json.dumps(counts, indent=1, sort_keys=True) + "\n", encoding="ascii")
    return counts


def _keep(found, corpus, n_kept):
    """Put the smallest data that reached something new into the corpus."""
    new = [path for path in found.glob("*") if not path.name.startswith("good")]
    new = sorted((path for path in new if path.stat().st_size <= LARGEST), key=_size)
    for path in new[:: max(1, len(new) // n_kept)][:n_kept] if n_kept else []:
        shutil.copyfile(path, corpus / f"{zlib.crc32(path.read_bytes()):08x}")


def _size(path):
    return path.stat().st_size


def main():
    if sys.argv[1:2] == ["--reader"]:
        fuzz_one(sys.argv[2], sys.argv[3:])
        return 0
    from fuzzing.readers import PARTS  # noqa: PLC0415

    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--runs", type=int, help="so many, the same each time, of all readers")
    parser.add_argument("--keep", type=int, default=0, help="new data a reader for the corpus")
    parser.add_argument("readers", nargs="*", default=[], help="all when none is named")
    arguments = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if arguments.runs:
        return int(fuzz_all([f"-runs={arguments.runs}", "-seed=1"], [TOGETHER]) > 0)
    names = arguments.readers or [*PARTS]
    share = max(1, round(arguments.seconds / len(names)))
    return int(fuzz_all([f"-max_total_time={share}"], names, arguments.keep) > 0)


if __name__ == "__main__":
    sys.exit(main())
