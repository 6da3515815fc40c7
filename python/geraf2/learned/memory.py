"""How much memory a training takes, before it starts."""

from geraf2.learned.config import PaperConfig
from geraf2.scene import Capture

# Measured as the growth of the largest resident set (single precision, forward and backward).
_BASE_BYTES = 500e6
_BYTES_PER_POINT = 900.0
_BYTES_PER_POINT_AND_GROUP = 80.0
_MLP_BYTES_PER_NEURON = 26.0
_MLP_BYTES_PER_NEURON_OF_VOXEL = 12.0  # of the value alone
_SDF_NEURONS, _MLP_NEURONS = 8 * 256, 8 * 256 + 4 * 256
_BYTES_PER_VOXEL = 40.0


def training_bytes(config: PaperConfig, capture: Capture, n_threads: int = 1) -> float:
    """Largest resident set of a training on a CPU [bytes], within a factor of 1.5."""
    n_points = 0.79 * config.n_cells**2 * config.n_samples  # the disc in its square
    n_groups = config.n_clusters or -(-config.n_antennas // config.bank)
    per_point = _BYTES_PER_POINT + _BYTES_PER_POINT_AND_GROUP * n_groups
    if config.field == "mlp":
        per_point += _MLP_BYTES_PER_NEURON * _MLP_NEURONS
    n_finest = config.grid_n[-1] ** 3
    n_voxels = n_finest + config.reflectivity_n**3 + config.mesh_n**3
    n_samples = sum(pose.signal.size for pose in capture.poses)
    if config.field != "mlp":
        n_points *= min(config.n_planes, len(capture.poses), n_threads)  # planes side by side
    network = 0.0
    if config.field == "mlp-grid":
        network = _MLP_BYTES_PER_NEURON_OF_VOXEL * _SDF_NEURONS * n_finest
    fields = network + _BYTES_PER_VOXEL * n_voxels
    return _BASE_BYTES + n_points * per_point + fields + 8.0 * n_samples
