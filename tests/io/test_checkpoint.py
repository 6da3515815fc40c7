import numpy as np
import pytest
from safetensors.numpy import save_file

from geraf2.errors import UserError
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint


@pytest.fixture
def checkpoint():
    arrays = {
        "weights": np.arange(6, dtype=np.float32).reshape(2, 3).T,  # not contiguous
        "random": np.arange(5, dtype=np.uint8),
        "scalar": np.array(2.5),
    }
    return Checkpoint(kind="paper", version=3, arrays=arrays, header={"step": 7, "stage": "one"})


def test_a_checkpoint_comes_back_as_it_was(checkpoint, tmp_path):
    save_checkpoint(tmp_path / "a.safetensors", checkpoint)
    back = load_checkpoint(tmp_path / "a.safetensors", kind="paper", version=3)
    assert back.header == checkpoint.header
    assert back.arrays.keys() == checkpoint.arrays.keys()
    for name, array in checkpoint.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array)
        assert back.arrays[name].dtype == array.dtype
        assert back.arrays[name].shape == array.shape
        assert back.arrays[name].flags.writeable


def test_other_kinds_versions_and_broken_files_are_one_line(checkpoint, tmp_path):
    path = tmp_path / "a.safetensors"
    with pytest.raises(UserError, match=r"a\.safetensors: cannot be read as a checkpoint"):
        load_checkpoint(path, kind="paper", version=3)
    save_checkpoint(path, checkpoint)
    with pytest.raises(UserError, match="of another kind, expected 'hybrid', got 'paper'"):
        load_checkpoint(path, kind="hybrid", version=3)
    with pytest.raises(
        UserError, match="another version of geraf2, expected layout 4, got layout 3"
    ):
        load_checkpoint(path, kind="paper", version=4)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="cannot be read as a checkpoint"):
        load_checkpoint(path, kind="paper", version=3)
    save_file({"weights": np.zeros(2)}, tmp_path / "b.safetensors")
    with pytest.raises(UserError, match="is not a checkpoint of geraf2"):
        load_checkpoint(tmp_path / "b.safetensors", kind="paper", version=3)


def test_the_same_state_is_the_same_bytes(tmp_path):
    header = {"b": 1, "a": [2, 3]}
    arrays = {name: np.arange(5.0) for name in ("z", "field", "a")}
    written = set()
    for number in range(20):  # the order of names was left to chance
        path = tmp_path / f"{number}.safetensors"
        save_checkpoint(path, Checkpoint(kind="k", version=1, arrays=arrays, header=header))
        written.add(path.read_bytes())
    assert len(written) == 1
