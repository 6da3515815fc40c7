"""How near two arrays are: by element, by norm, by direction, and on the average."""

import torch


def assert_close(got, want, *, element, norm, cosine, bias):
    """Compare real or complex tensors; every limit is relative to the root mean square of `want`.

    element: largest difference; norm: difference of the norms; cosine: 1 - |cosine|; bias: mean
    difference, which random rounding averages away and a systematic error does not.
    """
    assert got.shape == want.shape
    got = got.to(want.dtype).reshape(-1)
    want = want.reshape(-1)
    rms = want.abs().pow(2).mean().sqrt()
    assert rms > 0
    difference = got - want
    found = {
        "element": float(difference.abs().max() / rms),
        "norm": float((got.norm() / want.norm() - 1.0).abs()),
        "cosine": float(1.0 - torch.vdot(got, want).abs() / (got.norm() * want.norm())),
        "bias": float(difference.mean().abs() / rms),
    }
    limits = {"element": element, "norm": norm, "cosine": cosine, "bias": bias}
    worse = {name: (found[name], limits[name]) for name in found if not found[name] <= limits[name]}
    assert not worse, f"(found, limit): {worse}"
