"""Batches whose jobs run in this process, for tests that ask for other things than workers."""

import logging
from contextlib import contextmanager

import pytest

from geraf2.apps.batch import cluster
from geraf2.apps.batch.engine import MEMORY_RESOURCE


@contextmanager
def in_threads(n_workers, memory_bytes, retries=2):
    """As local_cluster, in threads."""
    from distributed import LocalCluster  # noqa: PLC0415 - an extra

    with LocalCluster(
        n_workers=n_workers,
        threads_per_worker=1,
        processes=False,
        dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # two tests at once: no fixed port
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        resources={MEMORY_RESOURCE: memory_bytes},
    ) as made:
        yield made


@pytest.fixture
def in_one_process(monkeypatch):
    """A worker that is a thread: a process takes 3 s to import what it needs."""
    monkeypatch.setattr(cluster, "local_cluster", in_threads)
