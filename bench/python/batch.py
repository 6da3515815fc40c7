"""Throughput, overhead and faults of `geraf2 batch` on processes of this machine.

    python bench/python/batch.py [--only NAME ...] [--scenes N] [--noop N ...] [--kills N]
        [--preset NAME]

scenes: small scenes, 4 planes each, by one worker and by two, of one thread each, against the
same scenes one after the other in this process, and in two processes at once without a scheduler,
which is the most that the machine gives. noop: jobs that do nothing but write their record.
kills: workers that are killed at random moments of a batch of 12 scenes, whose meshes must be
those of single runs.
"""

import argparse
import multiprocessing
import os
import random
import signal
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import distributed

import geraf2
from geraf2.apps.batch import BatchJob, BatchOptions, read_jobs, run, running
from geraf2.apps.batch.cluster import local_cluster
from geraf2.apps.batch.folder import JobPaths, JobResult
from geraf2.io.run_folder import CONTENT_NAME, file_digest
from geraf2.pipeline.stages.job import peak_memory_bytes
from geraf2.simulation import ScanSpec, simulate

BOX = geraf2.examples.BOX_M
OPTIONS = geraf2.RunOptions(calibrate="no")
FAST = geraf2.FastPreset()
PRESETS = {"fast": FAST, "best": geraf2.BestPreset()}
MEMORY_BYTES = 4e9


def make_scenes(folder: Path, count: int, spacing_m: float = 0.004) -> list[Path]:
    """One simulated scan, again and again with other noise: what matters here is the work."""
    scan = ScanSpec(n_poses=4, spacing_m=spacing_m, aperture_m=(0.12, 0.12))
    capture, _ = simulate(replace(geraf2.examples.small_scene(), scan=scan), seed=0)
    for i in range(count):
        poses = tuple(replace(p, signal=p.signal * (1.0 + 1e-3 * i)) for p in capture.poses)
        geraf2.save_capture(replace(capture, poses=poses), folder / f"scan_{i:04d}")
    return [folder / f"scan_{i:04d}" for i in range(count)]


def noop_job(job: BatchJob, paths: JobPaths, *_: object) -> JobResult:
    """Write the record of a job that took nothing."""
    result = JobResult(key=paths.key, scene=job.scene.name, preset="fast", state="done")
    paths.write(result)
    return result


def one_after_the_other(what: tuple[list[Path], str]) -> None:
    sources, preset = what
    for source in sources:
        with tempfile.TemporaryDirectory() as out:
            geraf2.reconstruct(
                source, BOX, preset, Path(out) / "run", options=OPTIONS, num_threads=1
            )


def scenes(count: int, preset: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sources = make_scenes(folder / "scans", count)
        one_after_the_other((sources[:1], preset))  # imports
        start, cpu = time.perf_counter(), time.process_time()
        alone = min(count, 20)
        one_after_the_other((sources[:alone], preset))
        wall, cpu = (time.perf_counter() - start) / alone, (time.process_time() - cpu) / alone
        print(f"reconstruct alone   {3600 / wall:8.0f} scans an hour, {cpu:.3f} CPU s a scan")
        with multiprocessing.get_context("spawn").Pool(2) as pool:
            pool.map(one_after_the_other, [(sources[:1], preset)] * 2, chunksize=1)  # imports
            start = time.perf_counter()
            pool.map(one_after_the_other, [(sources[:alone], preset)] * 2, chunksize=1)
            both = (time.perf_counter() - start) / (2 * alone)
        print(f"two of them at once {3600 / both:8.0f} scans an hour, {wall / both:.2f} of one")
        jobs = read_jobs(sources, box=BOX, config=PRESETS[preset], options=OPTIONS)
        rates: dict[int, float] = {}
        for n_workers in (1, 2):
            out = folder / f"out_{n_workers}"
            start = time.perf_counter()
            results = run(jobs, out, options=BatchOptions(workers=n_workers, threads=1))
            wall = time.perf_counter() - start
            assert {r.state for r in results} == {"done"}
            # The first of each process pays the imports; after that, every scan costs the same.
            spent = sorted(r.cpu_seconds for r in results)
            rates[n_workers] = count / wall
            print(
                f"{n_workers} worker(s)         {3600 * count / wall:8.0f} scans an hour, "
                f"{sum(spent) / count:.3f} CPU s a scan in its process "
                f"({sum(spent) / count / cpu:.3f} of alone), median {spent[count // 2]:.3f}"
            )
        print(f"two workers to one  {rates[2] / rates[1]:8.2f}")


def noop(counts: list[int]) -> None:
    running.do_job = noop_job
    with (
        tempfile.TemporaryDirectory() as name,
        local_cluster(2, MEMORY_BYTES) as cluster,
        distributed.Client(cluster) as client,
    ):
        for count in counts:
            folder = Path(name) / str(count)
            for i in range(count):
                (folder / "scans" / f"scan_{i:05d}").mkdir(parents=True)
                (folder / "scans" / f"scan_{i:05d}" / "scene.toml").touch()
            start, cpu = time.perf_counter(), time.process_time()
            jobs = read_jobs([str(folder / "scans" / "*")], box=BOX)
            listed = time.perf_counter() - start
            run(jobs, folder / "out", client)
            wall, cpu = time.perf_counter() - start, time.process_time() - cpu
            print(
                f"{count:6d} no-op jobs  {wall:7.1f} s, {1e3 * wall / count:.1f} ms a job ("
                f"{1e3 * listed / count:.2f} to read what is asked); client and scheduler "
                f"{1e3 * cpu / count:.2f} CPU ms a job, "
                f"{peak_memory_bytes() / 2**20:.0f} MiB",
                flush=True,
            )


def kills(count: int, n_scenes: int = 12) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sources = make_scenes(folder / "scans", n_scenes)
        wanted = []
        for source in sources:
            result = geraf2.reconstruct(source, BOX, "fast", options=OPTIONS, num_threads=1)
            wanted.append(file_digest(result.path / CONTENT_NAME))
        rng, killed, ended = random.Random(0), [], threading.Event()
        with (
            local_cluster(2, MEMORY_BYTES, retries=count) as cluster,
            distributed.Client(cluster) as client,
        ):

            def kill() -> None:
                while len(killed) < count and not ended.wait(rng.uniform(0.5, 8.0)):
                    workers = list(cluster.workers.values())
                    pid = workers[rng.randrange(len(workers))].pid
                    if pid is not None:
                        os.kill(pid, signal.SIGKILL)
                        killed.append(pid)

            killer, batches = threading.Thread(target=kill), 0
            killer.start()
            while killer.is_alive() or not batches:  # the same jobs into new folders
                out = folder / f"out_{batches}"
                jobs = read_jobs(sources, box=BOX, config=FAST, options=OPTIONS)
                results = run(jobs, out, client)
                runs = [next((out / "runs").glob(f"{r.scene}-*")) for r in results]
                found = [file_digest(run_folder / CONTENT_NAME) for run_folder in runs]
                same = sum(a == b for a, b in zip(found, wanted, strict=True))
                batches += 1
                print(
                    f"{len(killed)} workers killed so far, batch {batches}: {same} of {n_scenes} "
                    "meshes as of single runs"
                )
            ended.set()
            killer.join()
            left = [pid for pid in set(killed) if Path(f"/proc/{pid}/exe").exists()]
            print(f"{len(set(killed))} workers killed, {len(left)} of them still there")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    every = ["scenes", "noop", "kills"]
    parser.add_argument("--only", nargs="+", choices=every, default=every)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--preset", choices=list(PRESETS), default="best", help="of the scenes")
    parser.add_argument("--noop", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--kills", type=int, default=20)
    arguments = parser.parse_args()
    if "scenes" in arguments.only:
        scenes(arguments.scenes, arguments.preset)
    if "noop" in arguments.only:
        noop(arguments.noop)
    if "kills" in arguments.only:
        kills(arguments.kills)


if __name__ == "__main__":
    main()
