"""Records of a measurement: waveform, poses, walls, voxel domains. Frozen, SI."""

from geraf2.records import Pose, Wall, Waveform
from geraf2.scene.capture import Capture
from geraf2.scene.grid import Grid
from geraf2.scene.los import LosPrior
from geraf2.scene.store import load_capture, open_capture, save_capture

__all__ = [
    "Capture",
    "Grid",
    "LosPrior",
    "Pose",
    "Wall",
    "Waveform",
    "load_capture",
    "open_capture",
    "save_capture",
]
