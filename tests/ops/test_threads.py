"""Threads of the kernels: no bit depends on them, torch's number is theirs, none are added."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from threadpoolctl import ThreadpoolController

from geraf2.ops import matched_filter, ray_march, sdf_grid, signal_tracer
from geraf2.ops._threads import limit_blas_threads, resolve_num_threads
from geraf2.ops.grid_energy import GridEnergy
from geraf2.ops.physical_optics import SurfaceElements, physical_optics
from geraf2.ops.subaperture import subaperture_peaks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from helpers.antennas import bins_of, blocks_of, members_of
from helpers.aperture_images import kernel_images
from helpers.synthetic import waveform_of, white_noise

WAVEFORM = waveform_of(16)
RNG = np.random.default_rng(0)
N = 200
ANTENNAS = np.array([-0.4, 0.0, 0.0]) + RNG.uniform(-0.05, 0.05, (N, 3))
# Enough of everything for three threads.
N_POINTS = 7001
POINTS = RNG.uniform(-0.02, 0.02, (N_POINTS, 3))
FEW = POINTS[:900]
SIGNAL = white_noise((N, 16), np.complex64)
AMPLITUDE = RNG.normal(size=len(FEW)).astype(np.float32)
GRID = Grid.cube((0.0, 0.0, 0.0), 0.02, 12)
VALUES = RNG.normal(size=GRID.shape).astype(np.float32)
RAYS = RNG.normal(size=(3, 1000, 20)).astype(np.float32)
MEMBERS = members_of(
    ANTENNAS[:, 1:],
    offsets=np.array([0, 30, N]),
    focus=np.zeros((2, 3)),
    focus_range_m=np.full(2, 0.4),
)


def subapertures(threads):
    problem = (SIGNAL, ANTENNAS, ANTENNAS, WAVEFORM, MEMBERS, bins_of())
    peaks = subaperture_peaks(*problem, thresholds_db=(99.0, -99.0), num_threads=threads)
    return kernel_images(*problem, num_threads=threads), peaks.magnitudes, peaks.ranges_m


def energy(threads):
    shape = (33, 32, 31)
    n = int(np.prod(shape))
    matrix = GridEnergy(
        shape,
        (0.1, 0.1, 0.1),
        bending=0.5,
        sparse=sp.identity(n, format="csr"),
        diagonal=np.ones(n),
        num_threads=threads,
    )
    field = np.linspace(-1.0, 1.0, n)
    return matrix.apply(field), matrix.smooth(field, field, degree=3, low=0.1, high=4.0)


def echo(threads):
    elements = SurfaceElements(points=FEW, normals=np.tile([-1.0, 0, 0], (len(FEW), 1)))
    blocks = blocks_of(ANTENNAS, offsets=[0, 20, N], boresight=np.array([1.0, 0.0, 0.0]))
    weights = np.ones((2, len(FEW)), np.complex64)
    return (physical_optics(elements, weights, blocks, WAVEFORM, num_threads=threads),)


def mesh(threads):
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    scene = MeshScene(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], num_threads=threads)
    hits = scene.closest_hit(POINTS, POINTS[::-1])
    spans = scene.entry_exit(POINTS, POINTS[::-1])
    return (
        *(*hits, spans.t_entry, spans.t_exit),
        *(scene.signed_distance(POINTS), scene.winding_number(POINTS)),
    )


def gradients(function, *arrays):
    tensors = [torch.from_numpy(a).requires_grad_(True) for a in arrays]
    outputs = function(*tensors)
    outputs = outputs if isinstance(outputs, tuple) else (outputs,)
    real = [torch.view_as_real(o) if o.is_complex() else o for o in outputs]
    sum((o * o).sum() for o in real).backward()
    return (*(o.detach().numpy() for o in outputs), *(t.grad.numpy() for t in tensors))


KERNELS = {
    **{
        method: lambda n, m=method: gradients(
            lambda *a: matched_filter(*a, FEW, WAVEFORM, method=m, num_threads=n),
            SIGNAL,
            ANTENNAS,
            ANTENNAS,
        )
        for method in ("exact", "block")
    },
    "factorised": lambda n: gradients(
        lambda s: matched_filter(
            s, ANTENNAS, ANTENNAS, GRID, WAVEFORM, method="factorised", num_threads=n
        ),
        SIGNAL,
    ),
    "signal tracer": lambda n: gradients(
        lambda a, x: signal_tracer(a, x, ANTENNAS, ANTENNAS, WAVEFORM, num_threads=n),
        AMPLITUDE,
        FEW,
    ),
    "ray march": lambda n: gradients(
        lambda f, c, s: tuple(ray_march(f, c, np.abs(RAYS[2]), s, num_threads=n)),
        *RAYS[:2],
        np.array(2.0, dtype=np.float32),
    ),
    "grid interpolation": lambda n: gradients(
        lambda v, x: tuple(sdf_grid(v, GRID, x, interpolation="cubic", num_threads=n)),
        VALUES,
        POINTS,
    ),
    "sub-apertures": subapertures,
    "grid energy": energy,
    "physical optics": echo,
    "mesh scene": mesh,
}


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.usefixtures("simd")
def test_any_number_of_threads_and_each_repeat_give_the_same_bits(name):
    """The order of a sum is never that in which threads finish.

    Each thread of the signal tracer sums gradients of its own: their sum depends on the number.
    """
    alone, first = (KERNELS[name](n) for n in (1, 3))
    for position, (have, want) in enumerate(zip(first, alone, strict=True)):
        if name == "signal tracer" and position > 0:
            np.testing.assert_allclose(have, want, atol=1e-6 * np.abs(want).max())
        else:
            np.testing.assert_array_equal(have, want)
    for n in (2, 3) if name == "signal tracer" else (2, 4, 3):
        for have, want in zip(KERNELS[name](n), first, strict=True):
            if name != "signal tracer" or n == 3:
                np.testing.assert_array_equal(have, want)


def test_the_default_is_torch_s_number():
    before = torch.get_num_threads()
    try:
        for number in (1, 3):
            torch.set_num_threads(number)
            assert resolve_num_threads(None) == number
    finally:
        torch.set_num_threads(before)


COUNT_THREADS = """
import os, sys
sys.path[:0] = sys.argv[1:]
import torch
from threadpoolctl import ThreadpoolController
torch.set_num_threads(2)
x = torch.randn(400_000)
for _ in range(3):
    (x.sin() + x).sum()
before = len(os.listdir("/proc/self/task"))
from ops.test_threads import KERNELS
for kernel in KERNELS.values():
    kernel(None)
    (x.sin() + x).sum()
print(before, len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads in /proc")
def test_kernels_and_torch_share_their_threads():
    """One OpenMP runtime, one pool: two threads of torch and two of ours are two, not four."""
    environment = {**os.environ, "OMP_NUM_THREADS": "8", "OPENBLAS_NUM_THREADS": "1"}
    paths = [path for path in sys.path if path]
    done = subprocess.run(
        [sys.executable, "-c", COUNT_THREADS, *paths],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    before, after = map(int, done.stdout.split())
    assert after <= before + 1, done.stdout  # Embree may keep one


def test_small_products_of_numpy_take_one_thread_and_others_as_many_as_before():
    def n_threads():
        found = ThreadpoolController().select(internal_api="openblas").info()
        return [pool["num_threads"] for pool in found]

    before = n_threads()
    assert before  # NumPy's
    assert set(limit_blas_threads(n_threads)()) == {1}
    assert n_threads() == before


FORKS = """
import os, sys
sys.path[:0] = sys.argv[1:]
from ops.test_threads import in_a_fork
in_a_fork()
"""


def in_a_fork():
    """Kernels in a process, then the same in a fork of it, in which OpenMP's threads are not."""

    def work():
        grid = Grid.cube((0.0, 0.0, 0.0), 0.05, 16)
        antennas = ANTENNAS, ANTENNAS
        image = matched_filter(SIGNAL, *antennas, grid, WAVEFORM, num_threads=2)
        sphere = MeshScene(np.eye(3), [[0, 1, 2]], num_threads=2)
        return image.sum() + sphere.distance(grid.points()).sum()

    first = work()
    child = os.fork()
    if child == 0:
        os._exit(0 if work() == first else 3)
    sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="needs fork")
def test_a_fork_of_a_process_whose_kernels_ran_does_not_hang():
    paths = [path for path in sys.path if path]
    command = [sys.executable, "-W", "ignore", "-c", FORKS, *paths]
    assert subprocess.run(command, check=False, timeout=60).returncode == 0
