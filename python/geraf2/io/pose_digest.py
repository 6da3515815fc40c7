"""Hash of the content of poses, independent of their storage."""

import hashlib

import numpy as np

from geraf2.io.samples import complex_samples
from geraf2.records import RawPose

ANTENNA_ARRAYS = {"signal": "<c8", "tx_positions": "<f8", "rx_positions": "<f8"}
"""Arrays of a pose that grow with its antennas, and the type that the digest sees."""


class PoseDigest:
    """Content of poses in order, as a hash; padding and chunking do not matter."""

    def __init__(self) -> None:
        self._poses = hashlib.blake2b(digest_size=16)
        # SHA-256 has instructions of its own on most CPUs: twice as fast as blake2b. Safety is no
        # matter.
        self._arrays = {name: hashlib.sha256() for name in ANTENNA_ARRAYS}

    def add(self, pose: RawPose) -> None:
        """Add a pose."""
        for name, dtype in ANTENNA_ARRAYS.items():
            array = complex_samples(pose.signal) if name == "signal" else getattr(pose, name)
            if array.size:  # an empty array has no buffer
                self._arrays[name].update(np.ascontiguousarray(array, dtype=dtype).data)
        self._poses.update(f"{pose.name}|{pose.angle_deg}|{pose.signal.shape}".encode())
        self._poses.update(np.asarray(pose.axes, dtype=np.float64).tobytes())

    def hexdigest(self) -> str:
        """Hash so far."""
        whole = self._poses.copy()
        for array in self._arrays.values():
            whole.update(array.digest())
        return whole.hexdigest()
