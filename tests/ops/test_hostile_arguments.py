"""Arguments of public kernels that would end the process or never return are refused."""

import multiprocessing
import os
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from geraf2.ops import EchoForm, _threads, matched_filter
from geraf2.ops.grid_energy import GridEnergy
from geraf2.ops.lensless import facing_samples
from geraf2.ops.subaperture import Lattice
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from helpers.antennas import bins_of, blocks_of, members_of
from helpers.aperture_images import kernel_images
from helpers.synthetic import WAVEFORM, point_pose

POSE = point_pose(0.0, n_side=4, spacing_m=0.004)


def energy(columns):
    matrix = sp.csr_matrix((8, 8))
    matrix.indptr = np.array([0] + 8 * [len(columns)], dtype=np.int32)
    matrix.indices, matrix.data = np.array(columns, dtype=np.int32), np.ones(len(columns))
    return GridEnergy((2, 2, 2), (1.0, 1.0, 1.0), bending=1.0, sparse=matrix, diagonal=np.ones(8))


def looks(n_looks):
    form = EchoForm(centers=np.array([[1.0, 0.0, 0.0]]))
    return facing_samples(
        torch.ones(2, 3), torch.ones(6, 3), np.zeros((6, 3)), form, n_looks=n_looks
    )


def pattern(exponent):
    return blocks_of(np.zeros((2, 3)), pattern_exponent=exponent)


def images(lattice, scale=1.0):
    members = members_of(scale * POSE.tx_positions[:, 1:], lattice=lattice)
    antennas = POSE.signal, POSE.tx_positions, POSE.rx_positions
    return kernel_images(*antennas, WAVEFORM, members, bins_of())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: MeshScene(np.eye(3), [[0, 1, 2]], num_threads=10**6), "at most 1024, got 1000000"),
        (lambda: MeshScene(np.eye(3), [[0, 1, 2]], num_threads=-1), "at least 1, got -1"),
        (lambda: MeshScene(np.eye(3), [[0, 1, 2**40]]), "index 3 vertices"),
        (lambda: looks(0), "n_looks must be 1 to 10000, got 0"),
        (lambda: looks(-3), "n_looks must be 1 to 10000, got -3"),
        (lambda: looks(2**40), "n_looks must be 1 to 10000"),
        (lambda: energy([8]), "must be < 8"),
        (lambda: energy([2**31 - 1]), "must be < 8"),
        (lambda: energy([-1]), "must be >"),
        (lambda: pattern(2**31 - 1), "pattern_exponent must be 0 to 100, got 2147483647"),
        (lambda: pattern(-1), "pattern_exponent must be 0 to 100, got -1"),
        (lambda: images(Lattice(shape=(2**40, 2**40), spacing_m=(1.0, 1.0))), "lattice needs 1 to"),
        (lambda: images(Lattice(shape=(0, 4), spacing_m=(1.0, 1.0))), "lattice needs 1 to"),
        (lambda: images(None, 1e30), "`places` must lie in a sub-aperture"),
    ],
)
def test_it_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_position_far_off_its_lattice_is_put_on_the_rim():
    lattice = Lattice(shape=(4, 4), spacing_m=(0.004, 0.004))
    assert np.isfinite(images(lattice, 1e300)).all()


def test_threads_of_the_environment_are_bounded(monkeypatch):
    monkeypatch.setattr(_threads.sys, "modules", {})  # without torch, whose number they are
    monkeypatch.setattr(_threads._core, "max_threads", lambda: 99999)
    with pytest.raises(ValueError, match="at most 1024, got 99999; is OMP_NUM_THREADS right"):
        MeshScene(np.eye(3), [[0, 1, 2]])


FORKS = """
import os, sys
sys.path[:0] = sys.argv[1:]
from ops.test_hostile_arguments import in_a_fork
in_a_fork()
"""


def in_a_fork():
    """Kernels in a process, then the same in a fork of it, in which OpenMP's threads are not."""

    def work():
        grid = Grid.cube((0.0, 0.0, 0.0), 0.05, 16)
        signal = np.tile(POSE.signal, (30, 1))
        tx = np.tile(POSE.tx_positions, (30, 1))
        image = matched_filter(signal, tx, tx, grid, WAVEFORM, num_threads=2)
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
