"""What was measured and where: waveform, poses, walls, voxel domains. Frozen, SI."""

from geraf2.scene.capture import Capture, Pose, Wall
from geraf2.scene.grid import Grid
from geraf2.scene.los import LosPrior
from geraf2.scene.store import load_capture, save_capture
from geraf2.scene.waveform import Waveform

__all__ = [
    "Capture",
    "Grid",
    "LosPrior",
    "Pose",
    "Wall",
    "Waveform",
    "load_capture",
    "save_capture",
]
